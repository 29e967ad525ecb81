// Counts of the newest four windows, of two, and of the one that ended, for filters with several gains.
//
// A slot a clock with `step_i`, in a pass for each of them: of four first (`sum_i` 2), as the counters are
// drained, then of two (1) and of one (0). `valid_i` and `drained_i` come a step behind `slot_i`; the
// count, with its slot, follows two steps later. It saturates. While `clearing_i`, after reset, windows
// before the first become empty.
//
// Of the windows before, the memory keeps the newest one, the sum of it and the one before that, and the
// same sum of a window earlier: with the one that ends they make all sums.
module vpr_sums #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS = vpr_pkg::COUNT_BITS
) (
    input  logic                  clk_i,
    input  logic                  rst_i,
    input  logic                  step_i,
    input  logic [1:0]            sum_i,
    input  logic [SLOT_BITS-1:0]  slot_i,
    input  logic                  clearing_i,
    input  logic                  valid_i,
    input  logic                  last_i,
    input  logic [COUNT_BITS-1:0] drained_i,
    output logic                  valid_o,
    output logic                  last_o,
    output logic                  clearing_o,
    output logic [SLOT_BITS-1:0]  slot_o,
    output logic [COUNT_BITS-1:0] count_o
);
    logic [COUNT_BITS-1:0] one, two, two_before;
    logic [COUNT_BITS-1:0] one_q, two_q, next_before_q, two_before_q;
    logic                  valid_q, last_q, clearing_q;
    logic [SLOT_BITS-1:0]  read_slot_q, slot_q;

    function automatic [COUNT_BITS-1:0] saturated(
        input logic [COUNT_BITS-1:0] a, input logic [COUNT_BITS-1:0] b
    );
        logic [COUNT_BITS:0] sum;
        sum       = {1'b0, a} + {1'b0, b};
        saturated = sum[COUNT_BITS-1:0] | {COUNT_BITS{sum[COUNT_BITS]}};
    endfunction

    // the pass in which the memory takes the window that ended
    wire takes = sum_i == 2'd2;

    always_ff @(posedge clk_i) begin
        if (step_i) begin
            read_slot_q   <= slot_i;
            slot_q        <= read_slot_q;
            slot_o        <= slot_q;
            valid_q       <= valid_i;
            valid_o       <= valid_q;
            last_q        <= last_i;
            last_o        <= last_q;
            clearing_q    <= clearing_i;
            clearing_o    <= clearing_q;
            one_q         <= takes ? drained_i : one;
            two_q         <= takes ? saturated(drained_i, one) : two;
            next_before_q <= two;
            two_before_q  <= two_before;
            count_o       <= takes ? saturated(two_q, two_before_q) : sum_i[0] ? two_q : one_q;
        end
        if (rst_i) begin
            valid_q <= 1'b0;
            valid_o <= 1'b0;
            last_q  <= 1'b0;
            last_o  <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(3 * COUNT_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) counts (
        .clk_i(clk_i), .write_i(valid_q && (takes || clearing_q)), .write_address_i(slot_q),
        .write_word_i({next_before_q, two_q, one_q} & {3 * COUNT_BITS{!clearing_q}}),
        .read_i(step_i), .read_address_i(slot_i), .read_word_o({two_before, two, one})
    );
endmodule
