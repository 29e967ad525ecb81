// Best place, and second best outside its zone, of sums that come in ascending order of places.
//
// The best is a running minimum with a strict comparison: of equal sums the lowest place wins. When
// a place becomes the best, the places left of its zone are those that have left a delay line of
// EXCLUSION + 1 sums, and the lowest of them is `left`; places right of the zone come later.
//
// Two clocks a sum: compare, then update. Sums come at least two clocks apart, and `sum` and `place`
// stay for the clock after `sum_valid`. The result stands from two clocks after the last sum until
// `start`; without a second best, `second` and `second_sum` are 0.
module vpr_search #(
    localparam int EXCLUSION   = vpr_pkg::EXCLUSION,
    localparam int SUM_BITS    = vpr_pkg::SUM_BITS,
    localparam int PLACE_BITS  = vpr_pkg::PLACE_BITS,
    parameter  bit SLOW_BLOCKS = 0  // see vpr_core
) (
    input  logic                  clk,
    input  logic                  rst,
    input  logic                  start,
    input  logic                  sum_valid,
    input  logic [PLACE_BITS-1:0] place,
    input  logic [SUM_BITS-1:0]   sum,
    output logic                  became,  // in the clock after `sum_valid`: it is the best
    output logic                  has_best,
    output logic [PLACE_BITS-1:0] best,
    output logic [SUM_BITS-1:0]   best_sum,
    output logic [PLACE_BITS-1:0] ties,
    output logic                  has_second,
    output logic [PLACE_BITS-1:0] second,
    output logic [SUM_BITS-1:0]   second_sum
);
    localparam int DELAY     = EXCLUSION + 1;
    localparam int ZONE_BITS = $clog2(DELAY + 1);

    logic [ZONE_BITS-1:0]  filled;
    logic [ZONE_BITS-1:0]  behind;  // places since the best, at most EXCLUSION
    logic                  has_left;
    logic [PLACE_BITS-1:0] left;
    logic [SUM_BITS-1:0]   left_sum;

    // first clock: compare
    logic                  update;
    logic                  sum_lower, sum_equal, sum_below_second, oldest_lower;
    logic [PLACE_BITS-1:0] oldest_place;

    // the sum of DELAY places before, inverted, as it is compared
    logic [SUM_BITS-1:0] oldest_inverse;
    wire  [SUM_BITS-1:0] oldest = ~oldest_inverse;

    vpr_delay #(
        .STEPS(DELAY), .BITS(SUM_BITS), .IN_LOGIC(SLOW_BLOCKS)
    ) delay (
        .clk(clk), .rst(rst), .push(update), .word(~sum), .oldest(oldest_inverse)
    );

    // the carry of b + ~a says that a is less than b
    wire [SUM_BITS:0] below_best   = {1'b0, best_sum} + {1'b0, ~sum};
    wire [SUM_BITS:0] below_second = {1'b0, second_sum} + {1'b0, ~sum};
    wire [SUM_BITS:0] below_left   = {1'b0, left_sum} + {1'b0, oldest_inverse};

    always_ff @(posedge clk) begin
        update           <= sum_valid && !start && !rst;
        sum_lower        <= below_best[SUM_BITS];
        sum_equal        <= sum == best_sum;
        sum_below_second <= below_second[SUM_BITS];
        oldest_lower     <= below_left[SUM_BITS];
        oldest_place     <= place - PLACE_BITS'(DELAY);
    end

    // second clock: update
    wire leaves   = filled == ZONE_BITS'(DELAY);
    wire nearer   = leaves && (!has_left || oldest_lower);
    wire becomes  = !has_best || sum_lower;
    wire outside  = behind == ZONE_BITS'(EXCLUSION);
    assign became = update && becomes;

    wire [PLACE_BITS-1:0] next_left     = nearer ? oldest_place : left;
    wire [SUM_BITS-1:0]   next_left_sum = nearer ? oldest : left_sum;

    always_ff @(posedge clk) begin
        if (update) begin
            if (!leaves) filled <= filled + 1'b1;
            has_left <= has_left || leaves;
            left     <= next_left;
            left_sum <= next_left_sum;
            has_best <= 1'b1;
            if (becomes) begin
                best       <= place;
                best_sum   <= sum;
                ties       <= '0;
                behind     <= '0;
                has_second <= has_left || leaves;
                second     <= next_left;
                second_sum <= next_left_sum;
            end else begin
                if (sum_equal) ties <= ties + 1'b1;
                if (!outside) behind <= behind + 1'b1;
                else if (!has_second || sum_below_second) begin
                    has_second <= 1'b1;
                    second     <= place;
                    second_sum <= sum;
                end
            end
        end
        if (start || rst) begin
            filled     <= '0;
            behind     <= '0;
            has_left   <= 1'b0;
            has_best   <= 1'b0;
            has_second <= 1'b0;
            ties       <= '0;
            left       <= '0;
            left_sum   <= '0;
            second     <= '0;
            second_sum <= '0;
        end
    end

    wire unused = &{1'b0, below_best, below_second, below_left};
endmodule
