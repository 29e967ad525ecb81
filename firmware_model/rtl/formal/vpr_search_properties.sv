// What vpr_search must compute, for any number of sums at any times.
//
// One place `k` and one sum `v`, chosen freely and kept, stand for all. Places begin anywhere. The
// search's registers are seen through ports that the proof's script adds to it; they serve the
// invariant alone (INVARIANT), so that broken versions are refused by what the outputs must be.
module vpr_search_properties #(
    localparam EXCLUSION  = vpr_pkg::EXCLUSION,
    localparam SUM_BITS   = vpr_pkg::SUM_BITS,
    localparam PLACE_BITS = vpr_pkg::PLACE_BITS,
    parameter  INVARIANT  = 1
) (
    input logic                  clk,
    input logic                  rst,
    input logic                  start,
    input logic                  sum_valid,
    input logic [PLACE_BITS-1:0] place,
    input logic [SUM_BITS-1:0]   sum
);
    localparam DELAY     = EXCLUSION + 1;
    localparam ZONE_BITS = $clog2(DELAY + 1);

    logic                  has_best, has_second;
    logic [PLACE_BITS-1:0] best, second, ties;
    logic [SUM_BITS-1:0]   best_sum, second_sum;

    logic [DELAY*SUM_BITS-1:0] delayed;
    wire  [DELAY*SUM_BITS-1:0] sums = ~delayed;
    logic [ZONE_BITS-1:0]      filled, behind;
    logic                      has_left, update;
    logic [PLACE_BITS-1:0]     left, oldest_place;
    logic [SUM_BITS-1:0]       left_sum;
    logic                      becomes, sum_equal, becomes_second, nearer;

    vpr_search search (
        .clk_i(clk), .rst_i(rst), .start_i(start), .sum_valid_i(sum_valid), .place_i(place),
        .sum_i(sum),
        .has_best_o(has_best), .best_o(best), .best_sum_o(best_sum), .ties_o(ties),
        .has_second_o(has_second), .second_o(second), .second_sum_o(second_sum),
        .delayed_q(delayed), .filled_q(filled), .behind_q(behind), .has_left_q(has_left), .left_q(left),
        .left_sum_q(left_sum), .update_q(update), .becomes_q(becomes), .sum_equal_q(sum_equal),
        .becomes_second_q(becomes_second), .nearer_q(nearer),
        .oldest_place_q(oldest_place)
    );

    (* anyconst *) logic [PLACE_BITS-1:0] first;
    (* anyconst *) logic [PLACE_BITS-1:0] k;
    (* anyconst *) logic [SUM_BITS-1:0]   v;

    logic                  begun = 1'b0;
    logic                  pending = 1'b0;  // a sum was given in the clock before
    logic [PLACE_BITS:0]   next_place;      // place of the next sum
    logic [PLACE_BITS:0]   n;               // places below it are in the result
    logic                  seen;            // k is in the result
    logic [SUM_BITS-1:0]   sum_of_k;
    logic [PLACE_BITS:0]   equal_to_v;      // sums in the result that are v
    logic [PLACE_BITS-1:0] last_place;
    logic [SUM_BITS-1:0]   last_sum;

    wire [PLACE_BITS:0] wide_k = {1'b0, k}, wide_best = {1'b0, best}, wide_second = {1'b0, second};
    wire [PLACE_BITS:0] wide_left = {1'b0, left}, wide_first = {1'b0, first};
    wire [PLACE_BITS:0] taken = n - wide_first;
    wire [PLACE_BITS:0] since = n - 1'b1 - wide_best;
    wire [PLACE_BITS:0] age   = n - 1'b1 - wide_k;
    wire outside = wide_k + EXCLUSION < wide_best || wide_best + EXCLUSION < wide_k;

    always_ff @(posedge clk) begin
        last_place <= place;
        last_sum   <= sum;
        pending    <= sum_valid && !start && !rst;
        if (sum_valid) next_place <= next_place + 1'b1;
        if (pending) begin
            n <= n + 1'b1;
            if (place == k) begin
                seen     <= 1'b1;
                sum_of_k <= sum;
            end
            if (sum == v) equal_to_v <= equal_to_v + 1'b1;
        end
        if (start || rst) begin
            begun      <= 1'b1;
            next_place <= {1'b0, first};
            n          <= {1'b0, first};
            seen       <= 1'b0;
            equal_to_v <= 0;
        end
    end

    // what the sequence unit promises
    always_comb begin
        if (!begun) assume (start || rst);
        if (start) assume (!sum_valid && !pending);
        if (sum_valid) assume (!pending && {1'b0, place} == next_place);
        if (pending) assume (place == last_place && sum == last_sum);
    end

    // what the outputs must be
    always_comb begin
        if (begun) begin
            if (seen) begin
                assert (has_best);
                assert (best_sum <= sum_of_k);
                assert (sum_of_k > best_sum || best <= k);
                if (outside) begin
                    assert (has_second);
                    assert (second_sum <= sum_of_k);
                    assert (sum_of_k > second_sum || second <= k);
                end
                if (k == best) assert (best_sum == sum_of_k);
                if (has_second && k == second) assert (second_sum == sum_of_k && outside);
            end
            if (has_best) assert (best >= first && wide_best < n);
            if (has_second) assert (has_best && second >= first && wide_second < n);
            if (!has_second) assert (second == 0 && second_sum == 0);
            if (has_best && best_sum == v) assert ({1'b0, ties} + 1'b1 == equal_to_v);
        end
    end

    // what makes it inductive
    generate
        if (INVARIANT) begin : g_invariant
            always_comb begin
                if (begun) begin
                    assert (update == pending);
                    assert (next_place == n + pending);
                    if (pending) begin
                        assert ({1'b0, last_place} == n);
                        assert (becomes == (!has_best || last_sum < best_sum));
                        assert (sum_equal == (last_sum == best_sum));
                        assert (becomes_second == (behind == EXCLUSION
                            && (!has_second || last_sum < second_sum)));
                        assert (nearer == (filled == DELAY
                            && (!has_left || sums[EXCLUSION*SUM_BITS+:SUM_BITS] < left_sum)));
                        assert ({1'b0, oldest_place} + DELAY == n || filled != DELAY);
                    end
                    assert (n >= wide_first && next_place <= 1 << PLACE_BITS);
                    assert (seen == (k >= first && wide_k < n));
                    assert (has_best == (taken != 0));
                    assert (filled == (taken > EXCLUSION ? DELAY : taken));
                    assert (has_left == (taken > DELAY));
                    if (has_best) assert (behind == (since > EXCLUSION ? EXCLUSION : since));
                    if (has_left) assert (left >= first && wide_left + DELAY < n);
                    else assert (left == 0 && left_sum == 0);
                    if (seen && age > DELAY - 1'b1 && age != DELAY - 1'b1) begin
                        assert (has_left && left_sum <= sum_of_k);
                        assert (sum_of_k > left_sum || left <= k);
                    end
                    if (seen && has_left && left == k) assert (left_sum == sum_of_k);
                    if (seen && age <= EXCLUSION)
                        assert (sums[age*SUM_BITS+:SUM_BITS] == sum_of_k);
                    if (!has_best || best_sum > v) assert (equal_to_v == 0);
                    assert (equal_to_v <= taken);
                    if (has_best) assert ({1'b0, ties} < taken);
                end
            end
        end
    endgenerate
endmodule
