// What vpr_prediction must compute, for any metrics at any times.
//
// The metrics of the last places are kept here as they came, and the cheapest path is taken from them
// with as many bits as it may need. Metrics come two clocks apart at least, and the costs of steps
// are any, but those of the clock that counts are not above RESTART. The entries are seen through a
// port that the proof's script adds.
module vpr_prediction_properties #(
    localparam METRIC_BITS = vpr_pkg::METRIC_BITS,
    localparam RESTART     = vpr_pkg::RESTART
) (
    input logic                   clk,
    input logic                   clear,
    input logic                   shift,
    input logic [METRIC_BITS-1:0] metric,
    input logic [11:0]            costs
);
    // steps of 0, 1 and 2 places with costs of 4 bits, as the script sets them
    localparam ENTRIES = 3;
    localparam LATENCY = 4;  // of a tree of two levels, from the clock behind the one that shifts
    localparam WIDE    = 12;

    (* anyconst *) logic                   placed;
    (* anyconst *) logic [METRIC_BITS-1:0] least;

    logic [METRIC_BITS-1:0] prediction;
    localparam BITS = $clog2(RESTART + 1);
    logic [ENTRIES*BITS-1:0] entries;

    vpr_prediction predictions (
        .clk_i(clk), .clear_i(clear), .shift_i(shift), .metric_i(metric), .costs_i(costs),
        .placed_i(placed), .least_i(least), .prediction_o(prediction), .entries_q(entries)
    );

    logic                   begun = 1'b0;
    logic                   shifted = 1'b0;
    // as they came with the clock before
    logic                   shift_1 = 1'b0;
    logic [METRIC_BITS-1:0] metric_1;
    logic [ENTRIES-1:0]     there;
    logic [METRIC_BITS-1:0] come_0, come_1, come_2;

    always_ff @(posedge clk) begin
        shifted  <= shift && !clear;
        shift_1  <= shift;
        metric_1 <= metric;
        if (clear) begin
            begun <= 1'b1;
            there <= '0;
        end else if (shift_1) begin
            there  <= {there[1:0], 1'b1};
            come_0 <= metric_1;
            come_1 <= come_0;
            come_2 <= come_1;
        end
    end

    always_comb begin
        if (!begun) assume (clear);
        if (shift) assume (!shifted && metric >= least);
        assume (costs[3:0] <= RESTART && costs[7:4] <= RESTART && costs[11:8] <= RESTART);
    end

    function automatic [WIDE-1:0] path(input is, input [METRIC_BITS-1:0] from, input [WIDE-1:0] cost);
        path = is ? WIDE'(from) - WIDE'(least) + cost : '1;
    endfunction
    function automatic [WIDE-1:0] lesser(input [WIDE-1:0] a, input [WIDE-1:0] b);
        lesser = b < a ? b : a;
    endfunction

    wire [WIDE-1:0] moving = lesser(
        path(there[0], come_0, WIDE'(costs[3:0])),
        lesser(path(there[1], come_1, WIDE'(costs[7:4])), path(there[2], come_2, WIDE'(costs[11:8]))));
    wire [WIDE-1:0] cheapest = lesser(moving, WIDE'(RESTART));

    logic [WIDE-1:0]    due_1, due_2, due_3;
    logic [LATENCY-1:0] follows = '0;
    always_ff @(posedge clk) begin
        follows <= {follows[LATENCY-2:0], shift_1 && !clear && begun};
        due_1   <= cheapest;  // of the metric that was shifted in the clock before
        due_2   <= due_1;
        due_3   <= due_2;
    end

    function automatic [BITS-1:0] held(input is, input [METRIC_BITS-1:0] from);
        held = is && from - least < RESTART ? BITS'(from - least) : BITS'(RESTART);
    endfunction

    always_comb begin
        if (begun) begin
            assert (!there[0] || come_0 >= least);
            assert (!there[1] || come_1 >= least);
            assert (!there[2] || come_2 >= least);
            assert (entries == {held(there[2], come_2), held(there[1], come_1),
                                held(there[0], come_0)});
            if (follows[LATENCY-1]) begin
                assert (prediction == (placed ? due_3[METRIC_BITS-1:0] : '0));
                assert (prediction <= RESTART);
                assert (due_3 <= RESTART);
            end
        end
    end
endmodule
