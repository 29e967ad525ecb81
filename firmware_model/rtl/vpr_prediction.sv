// Price of the cheapest way to a place: by a step of 0, 1 ... places from a lower one, by a step
// back from a higher one, or by a restart, which costs the same for all. The metrics of the window
// before come in the order of places, with `shift`; `entry` is that of the place BACK ahead, or has
// its top bit set where that is off the map. `clear` sets all entries off the map.
//
// `prediction` is registered at the third clock edge after the one that shifts, and one more for
// each level of the tree of comparisons; it stays until the next. Before the first window
// (`placed`) it is 0. In a pause, steps of 0 and 1 are free, and one of 2 costs 1.
module vpr_prediction #(
    parameter int            STEPS        = 1,
    parameter int            BACK         = 0,
    parameter logic [159:0]  STEP_PRICES  = 0,
    parameter logic [159:0]  BACK_PRICES  = 0,
    parameter logic [9:0]    RESTART      = 0,
    parameter int            METRIC_BITS  = 10
) (
    input  logic                   clk,
    input  logic                   clear,
    input  logic                   shift,
    input  logic [METRIC_BITS:0]   entry,
    input  logic                   paused,
    input  logic                   placed,
    input  logic [METRIC_BITS-1:0] least,
    output logic [METRIC_BITS-1:0] prediction
);
    localparam int PAUSE_STEPS = 3;
    localparam logic [PAUSE_STEPS*10-1:0] PAUSE_PRICES = {10'd4, 10'd0, 10'd0};

    localparam int AHEAD   = STEPS > PAUSE_STEPS ? STEPS : PAUSE_STEPS;
    localparam int ENTRIES = AHEAD + BACK;
    localparam int LEVELS  = $clog2(ENTRIES);
    localparam int WIDE    = 1 << LEVELS;
    localparam int BITS    = METRIC_BITS + 2;

    // the newest, of the highest place, is the first
    logic [ENTRIES*(METRIC_BITS+1)-1:0] entries;

    always_ff @(posedge clk) begin
        if (clear) entries <= '1;
        else if (shift) entries <= (ENTRIES * (METRIC_BITS + 1))'({entries, entry});
    end

    // All ones is farther than any restart, also less the least metric
    genvar level, node;
    generate
        for (level = 0; level <= LEVELS; level = level + 1) begin : g_level
            localparam int NODES = WIDE >> level;
            wire [NODES*BITS-1:0] nearest;
            for (node = 0; node < NODES; node = node + 1) begin : g_node
                logic [BITS-1:0] found;
                assign nearest[node*BITS+:BITS] = found;
                if (level > 0) begin : g_nearer
                    wire [BITS-1:0] left  = g_level[level-1].nearest[2*node*BITS+:BITS];
                    wire [BITS-1:0] right = g_level[level-1].nearest[(2*node+1)*BITS+:BITS];
                    always_ff @(posedge clk) found <= right < left ? right : left;
                end else if (node < ENTRIES) begin : g_price
                    localparam int STEP = node - BACK;
                    localparam bit MOVES = STEP < 0 ? 1'b1 : STEP < STEPS;
                    localparam bit STANDS = STEP < 0 ? 1'b0 : STEP < PAUSE_STEPS;
                    localparam logic [9:0] MOVING =
                        !MOVES ? 10'd0 : STEP < 0 ? BACK_PRICES[10*(STEP<0?-STEP-1:0)+:10]
                        : STEP_PRICES[10*(STEP<0?0:STEP)+:10];
                    localparam logic [9:0] STANDING =
                        STANDS ? PAUSE_PRICES[10*(STANDS?STEP:0)+:10] : 10'd0;
                    wire [METRIC_BITS:0] metric = entries[node*(METRIC_BITS+1)+:METRIC_BITS+1];
                    wire [9:0]           price  = paused ? STANDING : MOVING;
                    always_ff @(posedge clk) begin
                        found <= (paused ? STANDS : MOVES)
                                         ? BITS'(metric) + BITS'(price) : '1;
                    end
                end else begin : g_filler
                    assign found = '1;
                end
            end
        end
    endgenerate

    wire [BITS-1:0] dearer = g_level[LEVELS].nearest - BITS'(least);

    always_ff @(posedge clk) begin
        prediction <= !placed ? '0 : dearer < BITS'(RESTART) ? dearer[METRIC_BITS-1:0]
                    : METRIC_BITS'(RESTART);
    end
endmodule
