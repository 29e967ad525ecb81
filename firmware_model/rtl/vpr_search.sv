// Best place, and second best outside its zone, of sums that come in ascending order of places.
//
// The best is a running minimum with a strict comparison: of equal sums the lowest place wins. When
// a place becomes the best, the places left of its zone are those that have left a delay line of
// EXCLUSION + 1 sums, and the lowest of them is `left_q`; places right of the zone come later.
//
// Two clocks a sum: compare, then update. Sums come at least two clocks apart, and `sum_i` and
// `place_i` stay for the clock after `sum_valid_i`. The result stands from two clocks after the last
// sum until `start_i`; without a second best, `second_o` and `second_sum_o` are 0.
module vpr_search #(
    localparam int EXCLUSION   = vpr_pkg::EXCLUSION,
    localparam int SUM_BITS    = vpr_pkg::SUM_BITS,
    localparam int PLACE_BITS  = vpr_pkg::PLACE_BITS,
    parameter  bit SLOW_BLOCKS = 0  // see vpr_core
) (
    input  logic                  clk_i,
    input  logic                  rst_i,
    input  logic                  start_i,
    input  logic                  sum_valid_i,
    input  logic [PLACE_BITS-1:0] place_i,
    input  logic [SUM_BITS-1:0]   sum_i,
    output logic                  became_o,  // in the clock after `sum_valid_i`: it is the best
    output logic                  has_best_o,
    output logic [PLACE_BITS-1:0] best_o,
    output logic [SUM_BITS-1:0]   best_sum_o,
    output logic [PLACE_BITS-1:0] ties_o,
    output logic                  has_second_o,
    output logic [PLACE_BITS-1:0] second_o,
    output logic [SUM_BITS-1:0]   second_sum_o
);
    localparam int DELAY     = EXCLUSION + 1;
    localparam int ZONE_BITS = $clog2(DELAY + 1);

    logic [ZONE_BITS-1:0]  filled_q;
    logic [ZONE_BITS-1:0]  behind_q;  // places since the best, at most EXCLUSION
    logic                  has_left_q;
    logic [PLACE_BITS-1:0] left_q;
    logic [SUM_BITS-1:0]   left_sum_q;

    // first clock: compare
    logic                  update_q;
    logic                  becomes_q, sum_equal_q, becomes_second_q, nearer_q;
    logic [PLACE_BITS-1:0] oldest_place_q;

    // the sum of DELAY places before, inverted, as it is compared
    logic [SUM_BITS-1:0] oldest_inverse;
    wire  [SUM_BITS-1:0] oldest = ~oldest_inverse;

    vpr_delay #(
        .STEPS(DELAY), .BITS(SUM_BITS), .IN_LOGIC(SLOW_BLOCKS)
    ) delay (
        .clk_i(clk_i), .rst_i(rst_i), .push_i(update_q), .word_i(~sum_i), .oldest_o(oldest_inverse)
    );

    // the carry of b + ~a says that a is less than b
    wire [SUM_BITS:0] below_best   = {1'b0, best_sum_o} + {1'b0, ~sum_i};
    wire [SUM_BITS:0] below_second = {1'b0, second_sum_o} + {1'b0, ~sum_i};
    wire [SUM_BITS:0] below_left   = {1'b0, left_sum_q} + {1'b0, oldest_inverse};

    wire leaves  = filled_q == ZONE_BITS'(DELAY);
    wire outside = behind_q == ZONE_BITS'(EXCLUSION);

    always_ff @(posedge clk_i) begin
        update_q         <= sum_valid_i && !start_i && !rst_i;
        becomes_q        <= !has_best_o || below_best[SUM_BITS];
        sum_equal_q      <= sum_i == best_sum_o;
        becomes_second_q <= outside && (!has_second_o || below_second[SUM_BITS]);
        nearer_q         <= leaves && (!has_left_q || below_left[SUM_BITS]);
        oldest_place_q   <= place_i - PLACE_BITS'(DELAY);
    end

    // second clock: update
    assign became_o = update_q && becomes_q;

    wire [PLACE_BITS-1:0] left_d     = nearer_q ? oldest_place_q : left_q;
    wire [SUM_BITS-1:0]   left_sum_d = nearer_q ? oldest : left_sum_q;

    always_ff @(posedge clk_i) begin
        if (update_q) begin
            if (!leaves) filled_q <= filled_q + 1'b1;
            has_left_q <= has_left_q || leaves;
            left_q     <= left_d;
            left_sum_q <= left_sum_d;
            has_best_o <= 1'b1;
            if (becomes_q) begin
                best_o       <= place_i;
                best_sum_o   <= sum_i;
                ties_o       <= '0;
                behind_q     <= '0;
                has_second_o <= has_left_q || leaves;
                second_o     <= left_d;
                second_sum_o <= left_sum_d;
            end else begin
                if (sum_equal_q) ties_o <= ties_o + 1'b1;
                if (!outside) behind_q <= behind_q + 1'b1;
                if (becomes_second_q) begin
                    has_second_o <= 1'b1;
                    second_o     <= place_i;
                    second_sum_o <= sum_i;
                end
            end
        end
        if (start_i || rst_i) begin
            filled_q     <= '0;
            behind_q     <= '0;
            has_left_q   <= 1'b0;
            has_best_o   <= 1'b0;
            has_second_o <= 1'b0;
            ties_o       <= '0;
            left_q       <= '0;
            left_sum_q   <= '0;
            second_o     <= '0;
            second_sum_o <= '0;
        end
    end

    wire unused = &{1'b0, below_best, below_second, below_left};
endmodule
