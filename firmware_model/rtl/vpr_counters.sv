// Counters of the open window, and those of the window that ended, in two banks that change places.
//
// The open bank: `slot` is read at a clock edge, `raised` is its count plus one, saturating, and is
// written with `raise`. The ended bank: `drain_slot` is read with `drain`, and cleared by the
// encoder afterwards. After reset, SLOTS clocks clear both banks.
module vpr_counters #(
    parameter int          SLOTS      = 1,
    parameter int          SLOT_BITS  = 1,
    parameter int          COUNT_BITS = 1,
    parameter int          COUNT_MAX  = 1
) (
    input  logic                  clk,
    input  logic                  rst,
    output logic                  clearing,
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
    logic [SLOT_BITS-1:0]  initial_slot;
    logic [COUNT_BITS-1:0] read_word_0, read_word_1;

    always_ff @(posedge clk) begin
        if (rst) begin
            open         <= 1'b0;
            clearing     <= 1'b1;
            initial_slot <= '0;
        end else begin
            if (swap) open <= !open;
            if (clearing) begin
                initial_slot <= initial_slot + 1'b1;
                if (initial_slot == SLOT_BITS'(SLOTS - 1)) clearing <= 1'b0;
            end
        end
    end

    wire [COUNT_BITS-1:0] count = open ? read_word_1 : read_word_0;
    assign raised  = count == FULL ? FULL : count + 1'b1;
    assign drained = open ? read_word_0 : read_word_1;

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_0 (
        .clk          (clk),
        .write        (clearing || (open ? clear : raise)),
        .write_address(clearing ? initial_slot : open ? clear_slot : slot),
        .write_word   (clearing || open ? COUNT_BITS'(0) : raised),
        .read         (!open || drain),
        .read_address (open ? drain_slot : slot),
        .read_word    (read_word_0)
    );

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) bank_1 (
        .clk          (clk),
        .write        (clearing || (open ? raise : clear)),
        .write_address(clearing ? initial_slot : open ? slot : clear_slot),
        .write_word   (clearing || !open ? COUNT_BITS'(0) : raised),
        .read         (open || drain),
        .read_address (open ? slot : drain_slot),
        .read_word    (read_word_1)
    );
endmodule
