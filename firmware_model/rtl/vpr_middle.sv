// Middle of the places around the best whose metric is near its own, which is what a match tells:
// with places at half windows, of those up to REACH places before it, and behind it, that follow one
// another. A place is near whose metric is at most 8 above the best.
//
// `ends_i` says that the best stands, and no sum comes any more. Places are then visited, one a
// clock, from REACH before the best on, or the first, to REACH behind it, or the last:
// `above_i` is the metric of `place_o` of two clocks before, in which `visits_o` was high, less
// the best, and `is_best_o` is high a clock behind the best. `told_o` stands 2 REACH + 5 clocks after
// `ends_i`, one more with several gains, until the next. Without a reach the best alone is visited, and
// told.
module vpr_middle #(
    localparam int PLACES      = vpr_pkg::PLACES,
    localparam int PLACE_BITS  = vpr_pkg::PLACE_BITS,
    localparam int METRIC_BITS = vpr_pkg::METRIC_BITS,
    localparam int GAINS       = vpr_pkg::GAINS,
    localparam int REACH       = vpr_pkg::REACH
) (
    input  logic                   clk_i,
    input  logic                   rst_i,
    input  logic                   ends_i,
    input  logic [PLACE_BITS-1:0]  best_i,
    output logic                   visits_o,
    output logic [PLACE_BITS-1:0]  place_o,
    input  logic [METRIC_BITS-1:0] above_i,
    output logic                   is_best_o,
    output logic [PLACE_BITS-1:0]  told_o
);
    generate
        if (REACH == 0) begin : g_best
            wire unused = &{1'b0, rst_i, above_i};
            assign place_o = best_i;
            assign told_o  = best_i;
            always_ff @(posedge clk_i) begin
                visits_o  <= ends_i;
                is_best_o <= visits_o;
            end
        end else begin : g_middle
            localparam logic [METRIC_BITS-1:0] NEAR = METRIC_BITS'(8);
            localparam int WIDE_BITS  = (PLACE_BITS > 3 ? PLACE_BITS : 3) + 1;
            localparam int BEHIND_BITS = $clog2(REACH + 1);
            localparam int BOTH_BITS  = BEHIND_BITS + 1;

            logic [BEHIND_BITS-1:0] behind_q;  // places behind the best, of the one that is visited
            // of the place that was visited, as it is read, and as it is counted
            logic                   before_1_q, before_2_q, behind_1_q, behind_2_q;
            logic                   near, is_before, is_behind;
            logic                   ended_q;
            // near places behind the best, less those before it
            logic signed [BOTH_BITS-1:0] both_q;

            wire [WIDE_BITS-1:0] first   = WIDE_BITS'(best_i) - WIDE_BITS'(REACH);
            wire                 at_best = place_o == best_i;
            wire                 last    = place_o == PLACE_BITS'(PLACES - 1)
                                           || behind_q == BEHIND_BITS'(REACH);
            // half of them, rounded up
            wire signed [BOTH_BITS-1:0] rounded = both_q + BOTH_BITS'(1);
            wire signed [BOTH_BITS-1:0] moves   = rounded >>> 1;

            if (GAINS == 1) begin : g_direct
                assign {near, is_before, is_behind} = {above_i <= NEAR, before_2_q, behind_2_q};
            end else begin : g_register
                always_ff @(posedge clk_i)
                    {near, is_before, is_behind} <= {above_i <= NEAR, before_2_q, behind_2_q};
            end

            always_ff @(posedge clk_i) begin
                visits_o <= ends_i || (visits_o && !last);
                if (ends_i) place_o <= first[WIDE_BITS-1] ? '0 : first[PLACE_BITS-1:0];
                else place_o <= place_o + 1'b1;
                if (ends_i) behind_q <= '0;
                else if (at_best || behind_q != 0) behind_q <= behind_q + 1'b1;
                is_best_o  <= visits_o && at_best;
                before_1_q <= visits_o && behind_q == 0 && !at_best;
                behind_1_q <= visits_o && behind_q != 0;
                before_2_q <= before_1_q;
                behind_2_q <= behind_1_q;
                if (ends_i) both_q <= '0;
                else if (is_before) both_q <= near ? both_q - 1'b1 : '0;
                else if (is_behind && near && !ended_q) both_q <= both_q + 1'b1;
                ended_q <= !ends_i && (ended_q || (is_behind && !near));
                told_o  <= best_i + PLACE_BITS'(moves);
                if (rst_i) visits_o <= 1'b0;
            end

            wire unused = &{1'b0, first};
        end
    endgenerate
endmodule
