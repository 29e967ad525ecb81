// Counters of the open window, and those of the window that ended, in two banks that change places.
//
// The open bank: `slot` is read at a clock edge, `raised` is its count plus one, saturating, and is
// written with `raise`. The ended bank: `drain_slot` is read with `drain`, and cleared by the
// encoder afterwards; while `clearing`, after reset, both banks are.
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
    input  logic [SLOT_BITS-1:0]  slot,
    input  logic                  raise,
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

    always_ff @(posedge clk) begin
        if (rst) open <= 1'b0;
        else if (swap) open <= !open;
    end

    wire clears_0 = clearing || open;
    wire clears_1 = clearing || !open;

    wire [COUNT_BITS-1:0] count = open ? read_word_1 : read_word_0;
    assign raised  = count == FULL ? FULL : count + 1'b1;
    assign drained = open ? read_word_0 : read_word_1;

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_0 (
        .clk          (clk),
        .write        (clears_0 ? clear : raise),
        .write_address(clears_0 ? clear_slot : slot),
        .write_word   (clears_0 ? COUNT_BITS'(0) : raised),
        .read         (!open || drain),
        .read_address (open ? drain_slot : slot),
        .read_word    (read_word_0)
    );

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_1 (
        .clk          (clk),
        .write        (clears_1 ? clear : raise),
        .write_address(clears_1 ? clear_slot : slot),
        .write_word   (clears_1 ? COUNT_BITS'(0) : raised),
        .read         (open || drain),
        .read_address (open ? slot : drain_slot),
        .read_word    (read_word_1)
    );
endmodule
