// Cost of the cheapest path to a place: by a step of 0, 1 ... places from a lower one, or by a
// restart, which costs the same for all. The metrics of the window before come in the order of
// places, with `shift_i`. `clear_i` forgets those before. `costs_i` are those of steps of 0, 1 ...
// places to the place, in the second clock behind `shift_i`; none is above RESTART.
//
// `prediction_o` is registered at the third clock edge after the one that shifts, and one more for
// each level of the tree of comparisons; it stays until the next. Before the first window
// (`placed_i`) it is 0. `above_o` is the metric of the clock before less the least.
module vpr_prediction #(
    localparam int           STEPS       = vpr_pkg::STEPS,
    localparam int           COST_BITS   = vpr_pkg::COST_BITS,
    localparam logic [6:0]   RESTART     = vpr_pkg::RESTART,
    localparam int           METRIC_BITS = vpr_pkg::METRIC_BITS
) (
    input  logic                   clk_i,
    input  logic                   clear_i,
    input  logic                   shift_i,
    input  logic [METRIC_BITS-1:0] metric_i,
    input  logic [STEPS*COST_BITS-1:0] costs_i,
    input  logic                   placed_i,
    input  logic [METRIC_BITS-1:0] least_i,
    output logic [METRIC_BITS-1:0] above_o,
    output logic [METRIC_BITS-1:0] prediction_o
);
    localparam int LEVELS = $clog2(STEPS + 1);
    localparam int WIDE   = 1 << LEVELS;
    // no path is dearer than a restart: what is dearer saturates before a cost is added
    localparam int BITS    = RESTART == 0 ? 1 : $clog2(RESTART + 1);
    // nor does a step cost more than it
    localparam int SUM_BITS = BITS + 1;

    localparam logic [BITS-1:0] LIMIT = BITS'(RESTART);

    // the newest, of the highest place, is the first; those off the map are as dear as a restart
    logic [STEPS*BITS-1:0] entries_q;

    // of the metric of the clock before
    logic [METRIC_BITS-1:0] above_inverse_q;
    wire  [METRIC_BITS-1:0] above = ~above_inverse_q;  // metric - least
    logic                   shifts_q;

    wire [METRIC_BITS:0]   below = {1'b0, above} - (METRIC_BITS + 1)'(RESTART);
    wire [BITS-1:0]        entry = !below[METRIC_BITS] ? LIMIT : BITS'(above);

    always_ff @(posedge clk_i) begin
        above_inverse_q <= ~metric_i + least_i;
        shifts_q        <= shift_i;
        if (clear_i) entries_q <= {STEPS{LIMIT}};
        else if (shifts_q) entries_q <= (STEPS * BITS)'({entries_q, entry});
    end

    genvar level, node;
    generate
        for (level = 0; level <= LEVELS; level = level + 1) begin : g_level
            localparam int NODES = WIDE >> level;
            wire [NODES*SUM_BITS-1:0] nearest;
            for (node = 0; node < NODES; node = node + 1) begin : g_node
                logic [SUM_BITS-1:0] minimum;
                assign nearest[node*SUM_BITS+:SUM_BITS] = minimum;
                if (level > 0) begin : g_nearer
                    wire [SUM_BITS-1:0] left  = g_level[level-1].nearest[2*node*SUM_BITS+:SUM_BITS];
                    wire [SUM_BITS-1:0] right =
                        g_level[level-1].nearest[(2*node+1)*SUM_BITS+:SUM_BITS];
                    always_ff @(posedge clk_i) minimum <= right < left ? right : left;
                end else if (node < STEPS) begin : g_cost
                    wire [BITS-1:0] cost = BITS'(costs_i[COST_BITS*node+:COST_BITS]);
                    always_ff @(posedge clk_i)
                        minimum <= SUM_BITS'(entries_q[node*BITS+:BITS]) + SUM_BITS'(cost);
                end else begin : g_filler
                    assign minimum = SUM_BITS'(RESTART);
                end
            end
        end
    endgenerate

    assign above_o      = above;
    assign prediction_o = placed_i ? METRIC_BITS'(g_level[LEVELS].nearest) : '0;

    wire unused = &{1'b0, below, g_level[LEVELS].nearest};
endmodule
