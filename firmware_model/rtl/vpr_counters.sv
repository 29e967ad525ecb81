// Counters of the open window, and those of the window that ended, in two banks that change places.
//
// The open bank takes a slot in each clock with `enable`: its count is read with the edge that takes
// it, raised by one, saturating, with the next, and written with the third, when `raised` and
// `raises` belong to it. A slot that comes again before that is raised from the newer count. The
// banks change places (`swap`) while no slot is on its way.
//
// The ended bank: `drain_slot` is read with `drain`, and cleared by the encoder afterwards; while
// `clearing`, after reset, both banks are.
module vpr_counters #(
    parameter int          SLOTS      = 1,
    parameter int          SLOT_BITS  = 1,
    parameter int          COUNT_BITS = 1,
    parameter int          COUNT_MAX  = 1
) (
    input  logic                  clk,
    input  logic                  rst,
    input  logic                  clearing,
    input  logic                  swap,
    input  logic                  enable,
    input  logic                  take,
    input  logic [SLOT_BITS-1:0]  slot,
    output logic                  raises,
    output logic [SLOT_BITS-1:0]  raised_slot,
    output logic [COUNT_BITS-1:0] raised,
    input  logic                  drain,
    input  logic [SLOT_BITS-1:0]  drain_slot,
    output logic [COUNT_BITS-1:0] drained,
    input  logic                  clear,
    input  logic [SLOT_BITS-1:0]  clear_slot
);
    localparam logic [COUNT_BITS-1:0] FULL = COUNT_BITS'(COUNT_MAX);

    logic                  open;  // 0 or 1: the bank of the open window
    logic [COUNT_BITS-1:0] read_word_0, read_word_1;

    // the slot whose count was read, and whether one of the two before it is the same
    logic                  reads, same_1, same_2;
    logic [SLOT_BITS-1:0]  read_slot;
    logic [COUNT_BITS-1:0] written;  // the latest count that was written

    wire [COUNT_BITS-1:0] read_word = open ? read_word_1 : read_word_0;
    wire [COUNT_BITS-1:0] count     = same_1 ? raised : same_2 ? written : read_word;

    assign drained = open ? read_word_0 : read_word_1;

    always_ff @(posedge clk) begin
        if (swap) open <= !open;
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
            open   <= 1'b0;
            reads  <= 1'b0;
            raises <= 1'b0;
        end
    end

    wire write    = enable && raises;
    wire clears_0 = clearing || open;
    wire clears_1 = clearing || !open;

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_0 (
        .clk          (clk),
        .write        (clears_0 ? clear : write),
        .write_address(clears_0 ? clear_slot : raised_slot),
        .write_word   (clears_0 ? COUNT_BITS'(0) : raised),
        .read         (open ? drain : enable),
        .read_address (open ? drain_slot : slot),
        .read_word    (read_word_0)
    );

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_1 (
        .clk          (clk),
        .write        (clears_1 ? clear : write),
        .write_address(clears_1 ? clear_slot : raised_slot),
        .write_word   (clears_1 ? COUNT_BITS'(0) : raised),
        .read         (open ? enable : drain),
        .read_address (open ? slot : drain_slot),
        .read_word    (read_word_1)
    );
endmodule
