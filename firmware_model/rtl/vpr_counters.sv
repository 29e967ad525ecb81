// Counters of a window, as it is open and while it is drained.
//
// While it is open, a slot is taken in each clock with `enable`: its count is read with the edge that
// takes it, raised by one, saturating, with the next, and written with the third, when `raised` and
// `raises` belong to it. A slot that comes again before that is raised from the newer count.
//
// While it is drained, and no slot is on its way (`draining`), `drain_slot` takes the same way with
// `drain`: it is read, `drained` and `read_slot` stay until the next, and in place of a raised count 0
// is written. No slot is taken in the two clocks after that; `enable` is high meanwhile.
module vpr_counters #(
    localparam int SLOTS       = vpr_pkg::SLOTS,
    localparam int SLOT_BITS   = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS  = vpr_pkg::COUNT_BITS,
    localparam int COUNT_MAX   = vpr_pkg::COUNT_MAX,
    parameter  bit SLOW_BLOCKS = 0  // see vpr_core
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
    output logic [SLOT_BITS-1:0]  read_slot
);
    localparam logic [COUNT_BITS-1:0] FULL = COUNT_BITS'(COUNT_MAX);

    // the slot whose count was read, and whether one of the two before it is the same
    logic                  reads, clears, same_1, same_2;
    logic                  writes;   // `raised`, or 0
    logic [COUNT_BITS-1:0] written;  // the latest count that was written

    wire [COUNT_BITS-1:0] count   = same_1 ? raised : same_2 ? written : drained;
    wire                  read    = draining ? drain : enable;
    wire [SLOT_BITS-1:0]  address = draining ? drain_slot : slot;

    always_ff @(posedge clk) begin
        if (read) read_slot <= address;
        if (enable) begin
            reads       <= draining ? drain : take;
            clears      <= draining;
            same_1      <= reads && slot == read_slot;
            same_2      <= writes && slot == raised_slot;
            raises      <= reads && !clears;
            writes      <= reads;
            raised_slot <= read_slot;
            raised      <= clears ? '0 : count == FULL ? FULL : count + 1'b1;
            written     <= raised;
        end
        if (rst) begin
            reads  <= 1'b0;
            raises <= 1'b0;
            writes <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS), .IN_LOGIC(SLOW_BLOCKS)
    ) counts (
        .clk          (clk),
        .write        (enable && writes),
        .write_address(raised_slot),
        .write_word   (raised),
        .read         (read),
        .read_address (address),
        .read_word    (drained)
    );
endmodule
