// Counters of a window, as it is open and while it is drained.
//
// While it is open, a slot is taken in each clock with `enable`: its count is read with the edge that
// takes it, raised by one, saturating, with the next, and written with the third, when `raised` and
// `raises` belong to it. A slot that comes again before that is raised from the newer count.
//
// While it is drained, and no slot is on its way (`draining`), `drain_slot` is read with `drain`, and
// the encoder clears each slot afterwards.
module vpr_counters #(
    parameter int          SLOTS      = 1,
    parameter int          SLOT_BITS  = 1,
    parameter int          COUNT_BITS = 1,
    parameter int          COUNT_MAX  = 1,
    parameter bit          SLOW_BLOCKS = 0  // see vpr_device
) (
    input  logic                  clk,
    input  logic                  rst,
    input  logic                  enable,
    input  logic                  take,
    input  logic [SLOT_BITS-1:0]  slot,
    output logic                  raises,
    output logic [SLOT_BITS-1:0]  raised_slot,
    output logic [COUNT_BITS-1:0] raised,
    input  logic                  draining,
    input  logic                  drain,
    input  logic [SLOT_BITS-1:0]  drain_slot,
    output logic [COUNT_BITS-1:0] drained,
    input  logic                  clear,
    input  logic [SLOT_BITS-1:0]  clear_slot
);
    localparam logic [COUNT_BITS-1:0] FULL = COUNT_BITS'(COUNT_MAX);

    // the slot whose count was read, and whether one of the two before it is the same
    logic                  reads, same_1, same_2;
    logic [SLOT_BITS-1:0]  read_slot;
    logic [COUNT_BITS-1:0] written;  // the latest count that was written

    wire [COUNT_BITS-1:0] count = same_1 ? raised : same_2 ? written : drained;

    always_ff @(posedge clk) begin
        if (enable) begin
            reads       <= take;
            read_slot   <= slot;
            same_1      <= reads && slot == read_slot;
            same_2      <= raises && slot == raised_slot;
            raises      <= reads;
            raised_slot <= read_slot;
            raised      <= count == FULL ? FULL : count + 1'b1;
            written     <= raised;
        end
        if (rst) begin
            reads  <= 1'b0;
            raises <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS), .IN_LOGIC(SLOW_BLOCKS)
    ) counts (
        .clk          (clk),
        .write        (clear || (enable && raises)),
        .write_address(clear ? clear_slot : raised_slot),
        .write_word   (clear ? COUNT_BITS'(0) : raised),
        .read         (draining ? drain : enable),
        .read_address (draining ? drain_slot : slot),
        .read_word    (drained)
    );
endmodule
