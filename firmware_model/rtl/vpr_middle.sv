// Middle of the places around the best whose metric is near its own, which is what a match tells:
// with places at half windows, of those up to REACH places before it, and behind it, that follow one
// another. A place is near whose metric is at most 8 above the best.
//
// `ends_i` says that the best stands, and no sum comes any more. Places are then visited, one a
// clock, from REACH before the best on, of which those in front of the first do not count, to REACH
// behind it, or the last:
// `above_i` is the metric of `place_o` of two clocks before, in which `visits_o` was high, less
// the best, and `is_best_o` is high a clock behind the best. `told_o` stands 2 REACH + 6 clocks after
// `ends_i`, until the next. Without a reach the best alone is visited, and told.
module vpr_middle #(
    localparam int PLACES      = vpr_pkg::PLACES,
    localparam int PLACE_BITS  = vpr_pkg::PLACE_BITS,
    localparam int METRIC_BITS = vpr_pkg::METRIC_BITS,
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
            localparam int BOTH_BITS  = $clog2(REACH + 1) + 1;

            // the place that is visited, also in front of the first; and how far it is from the best
            logic [WIDE_BITS-1:0]        place_q;
            logic signed [BOTH_BITS-1:0] from_best_q;
            // of the place that was visited, as it is read, as its metric stands, and as it is counted
            logic                   before_1_q, before_2_q, behind_1_q, behind_2_q;
            logic                   near_q, is_before_q, is_behind_q;
            logic                   ended_q;
            // near places behind the best, less those before it
            logic signed [BOTH_BITS-1:0] both_q;

            wire at_best = from_best_q == 0;
            wire last    = place_q == WIDE_BITS'(PLACES - 1) || from_best_q == BOTH_BITS'(REACH);

            assign place_o = place_q[PLACE_BITS-1:0];

            // half of them, rounded up
            wire signed [BOTH_BITS-1:0] rounded = both_q + BOTH_BITS'(1);
            wire signed [BOTH_BITS-1:0] moves   = rounded >>> 1;

            always_ff @(posedge clk_i) begin
                visits_o <= ends_i || (visits_o && !last);
                place_q     <= ends_i ? WIDE_BITS'(best_i) - WIDE_BITS'(REACH) : place_q + 1'b1;
                from_best_q <= ends_i ? -BOTH_BITS'(REACH) : from_best_q + 1'b1;
                is_best_o   <= visits_o && at_best;
                before_1_q  <= visits_o && from_best_q < 0 && !place_q[WIDE_BITS-1];
                behind_1_q  <= visits_o && from_best_q > 0;
                before_2_q  <= before_1_q;
                behind_2_q  <= behind_1_q;
                near_q      <= above_i <= NEAR;
                is_before_q <= before_2_q;
                is_behind_q <= behind_2_q;
                if (ends_i) both_q <= '0;
                else if (is_before_q) both_q <= near_q ? both_q - 1'b1 : '0;
                else if (is_behind_q && near_q && !ended_q) both_q <= both_q + 1'b1;
                ended_q <= !ends_i && (ended_q || (is_behind_q && !near_q));
                told_o  <= best_i + PLACE_BITS'(moves);
                if (rst_i) visits_o <= 1'b0;
            end
        end
    endgenerate
endmodule
