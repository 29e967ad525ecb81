// Place filter: a metric for every place, advanced window by window. It stands where vpr_sequence
// stands for sequences, and hands the search a metric of each place in their order.
//
// A window takes passes over all places: for the mean of the distances; for their spread, unless it
// is known from the window before; and for the metrics, each the prediction plus the evidence,
// saturated. Each pass asks for the distances again (`distance_start`), unless they are kept
// (KEEP_DISTANCES); those of the first pass come unasked, some clocks after `start`. In a pause there
// is no evidence, and there are no distances. The spread of this window is divided after its match; until
// then the unit is not `idle`, and no window may end. No pass for metrics begins before the window's
// activity stands (`settled`): it says what the evidence weighs, and what steps cost
// (ACTIVITY_COSTS; otherwise STEP_PRICES).
//
// `misfit` is the evidence that the metric has, saturated at 23. `found` says that the search stands at
// `best_sum`, the least metric. Distances come two clocks apart at least, and so do metrics.
module vpr_filter #(
    localparam int           PLACES          = vpr_pkg::PLACES,
    localparam bit           KEEP_DISTANCES  = vpr_pkg::KEEP_DISTANCES,
    localparam int           STEPS           = vpr_pkg::STEPS,
    localparam int           BACK            = vpr_pkg::BACK,
    localparam bit           ACTIVITY_COSTS  = vpr_pkg::ACTIVITY_COSTS,
    localparam logic [159:0] STEP_PRICES     = vpr_pkg::STEP_PRICES,
    localparam logic [9:0]   RESTART         = vpr_pkg::RESTART,
    localparam int           PLACE_BITS      = vpr_pkg::PLACE_BITS,
    localparam int           DISTANCE_BITS   = vpr_pkg::DISTANCE_BITS,
    localparam int           RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS,
    localparam int           COST_BITS       = vpr_pkg::COST_BITS,
    localparam int           EVIDENCE_BITS   = vpr_pkg::EVIDENCE_BITS,
    localparam int           METRIC_BITS     = vpr_pkg::METRIC_BITS,
    localparam int           MISFIT_BITS     = vpr_pkg::MISFIT_BITS,
    parameter  bit           LOADABLE        = 0
) (
    input  logic                     clk,
    input  logic                     rst,
    input  logic                     load,  // see vpr_rom
    input  logic [19:0]              load_address,
    input  logic [31:0]              load_word,
    input  logic                     start,
    input  logic                     paused,
    input  logic                     settled,
    input  logic [9:0]               activity_inverse,
    output logic                     idle,
    output logic                     distance_start,
    input  logic                     distance_valid,
    input  logic [DISTANCE_BITS-1:0] distance,
    output logic                     sum_valid,
    output logic                     sum_last,
    output logic [PLACE_BITS-1:0]    place,
    output logic [METRIC_BITS-1:0]   sum,
    output logic [MISFIT_BITS-1:0]   misfit,
    input  logic                     found,
    input  logic [METRIC_BITS-1:0]   best_sum
);
    localparam int ENTRIES       = STEPS + BACK;
    // from a place's distance to its prediction; the evidence takes 4 or 5, and waits for it
    localparam int PREDICTED     = 3 + $clog2(ENTRIES + 1);
    localparam int WAITS         = PREDICTED > 5 ? PREDICTED - 5 : 0;
    localparam int PRODUCT_BITS  = DISTANCE_BITS + RECIPROCAL_BITS - 1;
    // fraction bits of the reciprocal, less those of a metric
    localparam int SHIFT         = RECIPROCAL_BITS - 1 - 2;
    localparam int LEAD_BITS     = $clog2(BACK + 2);
    localparam logic [MISFIT_BITS-1:0] MISFIT_TOP = MISFIT_BITS'(23);

    localparam logic [1:0] IDLE   = 2'd0;
    localparam logic [1:0] LEAD   = 2'd1;  // metrics of the BACK places ahead of the first
    localparam logic [1:0] RUN    = 2'd2;
    localparam logic [1:0] DIVIDE = 2'd3;

    localparam logic [1:0] FOR_MEAN    = 2'd0;
    localparam logic [1:0] FOR_SPREAD  = 2'd1;
    localparam logic [1:0] FOR_METRICS = 2'd2;

    logic [1:0]                 state, pass;
    logic                       waiting, beat, ends, divide, done;
    logic                       scaled;  // by the spread of this window
    logic [LEAD_BITS-1:0]       lead;
    logic [PLACE_BITS-1:0]      index;
    logic [DISTANCE_BITS-1:0]   kept, nearest_inverse;
    logic                       known, whole;
    logic [RECIPROCAL_BITS-2:0] factor;  // see vpr_spread

    // A place: its distance comes from the distance unit, from memory, or is not asked for
    wire                     unasked   = paused || (KEEP_DISTANCES && pass != FOR_MEAN);
    wire                     item      = state == RUN && (unasked ? beat : distance_valid);
    wire [DISTANCE_BITS-1:0] here      = KEEP_DISTANCES && pass != FOR_MEAN ? kept : distance;
    // the distance less the nearest; the carry says that it is not below
    wire [DISTANCE_BITS+1:0] farther   = {1'b0, here, 1'b1} + {1'b0, nearest_inverse, 1'b1};
    wire                     item_last = index == PLACE_BITS'(PLACES - 1);
    wire                     begins    = waiting;  // it is idle when a window begins
    wire                     leads     = state == LEAD && beat;
    assign idle = state == IDLE && !waiting;
    // the next pass: one after the mean, unless this window's own spread is needed first
    wire [1:0]               next_pass =
        pass == FOR_MEAN && !known ? FOR_SPREAD : FOR_METRICS;

    always_ff @(posedge clk) begin
        waiting        <= start || (waiting && paused && !settled);
        beat           <= (state == RUN || state == LEAD) && !beat;
        distance_start <= 1'b0;
        divide         <= 1'b0;
        ends           <= (item && item_last) || (ends && !settled);
        case (state)
            IDLE: begin
                pass <= paused ? FOR_METRICS : FOR_MEAN;
                if (waiting && (!paused || settled)) state <= paused && BACK > 0 ? LEAD : RUN;
            end
            LEAD: if (leads && lead == 1) begin
                state          <= RUN;
                beat           <= 1'b0;
                distance_start <= !unasked;
            end
            RUN: if (ends && settled) begin
                state  <= paused || scaled ? IDLE : DIVIDE;
                divide <= !paused && !scaled;
            end
            default: if (done) begin
                pass   <= next_pass;
                scaled <= pass == FOR_SPREAD;
                if (pass == FOR_METRICS) state <= IDLE;
                else begin
                    state          <= next_pass == FOR_METRICS && BACK > 0 ? LEAD : RUN;
                    distance_start <= !KEEP_DISTANCES && !(next_pass == FOR_METRICS && BACK > 0);
                end
            end
        endcase
        if (leads) lead <= lead - 1'b1;
        if (state == IDLE || state == DIVIDE) begin
            index <= '0;
            lead  <= LEAD_BITS'(BACK);
        end else if (item && !item_last) index <= index + 1'b1;
        if (begins) scaled <= 1'b0;
        if (begins) nearest_inverse <= '0;
        else if (distance_valid && pass == FOR_MEAN && !farther[DISTANCE_BITS+1])
            nearest_inverse <= ~distance;
        if (rst) begin
            state          <= IDLE;
            waiting        <= 1'b0;
            ends           <= 1'b0;
            distance_start <= 1'b0;
        end
    end

    vpr_spread scale (
        .clk(clk), .rst(rst), .clear(begins), .valid(item && !paused), .distance(here),
        .of_mean(pass == FOR_MEAN), .divide(divide), .done(done),
        .known(known), .whole(whole), .factor(factor)
    );

    generate
        if (KEEP_DISTANCES) begin : g_keep
            vpr_ram #(
                .DEPTH(PLACES), .BITS(DISTANCE_BITS), .ADDRESS_BITS(PLACE_BITS)
            ) distances (
                .clk(clk), .write(item && pass == FOR_MEAN && !paused), .write_address(index),
                .write_word(distance), .read(1'b1), .read_address(index), .read_word(kept)
            );
        end else begin : g_again
            assign kept = '0;
        end
    endgenerate

    logic [METRIC_BITS-1:0] sum_inverse;  // as the search compares it
    assign sum = ~sum_inverse;

    // Prediction: the metrics of the window before are read BACK places ahead

    logic                   placed;
    logic [METRIC_BITS-1:0] least, former_inverse, prediction;
    logic [PLACE_BITS-1:0]  ahead;  // its metric is read
    logic                   off;

    wire metrics = item && pass == FOR_METRICS;
    wire shift   = metrics || leads;

    always_ff @(posedge clk) begin
        if (found) begin
            least  <= best_sum;
            placed <= 1'b1;
        end
        if (rst) placed <= 1'b0;
    end

    generate
        if (BACK == 0) begin : g_here
            assign ahead = index;
            assign off   = 1'b0;
        end else begin : g_ahead
            always_ff @(posedge clk) begin
                if (state == IDLE || state == DIVIDE) begin
                    ahead <= '0;
                    off   <= 1'b0;
                end else if (shift) begin
                    if (ahead == PLACE_BITS'(PLACES - 1)) off <= 1'b1;
                    else ahead <= ahead + 1'b1;
                end
            end
        end
    endgenerate

    vpr_ram #(
        .DEPTH(PLACES), .BITS(METRIC_BITS), .ADDRESS_BITS(PLACE_BITS)
    ) metric_memory (
        .clk(clk), .write(sum_valid), .write_address(place), .write_word(sum_inverse),
        .read(1'b1), .read_address(ahead), .read_word(former_inverse)
    );

    logic [STEPS*COST_BITS-1:0] costs;

    generate
        if (ACTIVITY_COSTS) begin : g_by_activity
            vpr_step_costs #(.LOADABLE(LOADABLE)) step_costs (
                .clk(clk), .load(load), .load_address(load_address), .load_word(load_word),
                .activity_inverse(activity_inverse), .place(index), .costs(costs)
            );
        end else begin : g_fixed
            genvar step;
            for (step = 0; step < STEPS; step = step + 1) begin : g_step
                localparam logic [9:0] PRICE = STEP_PRICES[10*step+:10];
                assign costs[COST_BITS*step+:COST_BITS] = PRICE < RESTART ? PRICE : RESTART;
            end
            wire unused = &{1'b0, load, load_address, load_word};
        end
    endgenerate

    vpr_prediction predictions (
        .clk(clk), .clear(state == IDLE || state == DIVIDE), .shift(shift),
        .off(off), .metric(~former_inverse), .costs(costs), .placed(placed),
        .least(least), .prediction(prediction)
    );

    // Evidence: how far the place's distance is above the least, by the reciprocal of the spread,
    // limited, and of that as many eighths as the window's activity says: all of them from 2 octaves
    // below the usual one on, none 3 below it. In a pause there is none.

    wire [9:0] activity = ~activity_inverse;
    wire [3:0] weight   = !activity[9] || &activity[8:5] ? 4'd8
                          : activity[8:4] == 5'b11101 ? {1'b0, activity[3:1]} : 4'd0;

    logic [DISTANCE_BITS-1:0] above;
    logic [PRODUCT_BITS-1:0]  product;
    logic [EVIDENCE_BITS-1:0] limited;
    logic [EVIDENCE_BITS+3:0] evidence;  // in eighths
    logic [PREDICTED-1:0]     valid;

    // half of a reciprocal of 2^16: a shift of one bit less
    wire [PRODUCT_BITS-SHIFT:0] divided =
        whole ? product[PRODUCT_BITS-1:SHIFT-1] : {1'b0, product[PRODUCT_BITS-1:SHIFT]};

    wire  [EVIDENCE_BITS-1:0]     against;
    wire [METRIC_BITS:0]          metric = {1'b0, prediction} + (METRIC_BITS + 1)'(against);

    generate
        if (WAITS == 0) begin : g_at_once
            assign against = evidence[EVIDENCE_BITS+2:3];
        end else begin : g_waits
            integer i;
            logic [EVIDENCE_BITS-1:0] waits[0:WAITS-1];
            always_ff @(posedge clk) begin
                waits[0] <= evidence[EVIDENCE_BITS+2:3];
                for (i = 1; i < WAITS; i = i + 1) waits[i] <= waits[i-1];
            end
            assign against = waits[WAITS-1];
        end
    endgenerate

    always_ff @(posedge clk) begin
        if (item) above <= farther[DISTANCE_BITS:1];
        product     <= PRODUCT_BITS'(above) * PRODUCT_BITS'(factor);
        limited     <= paused ? '0
                       : (divided >> EVIDENCE_BITS) != 0 ? '1 : EVIDENCE_BITS'(divided);
        evidence    <= (EVIDENCE_BITS + 4)'(limited) * (EVIDENCE_BITS + 4)'(weight);
        valid <= PREDICTED'({valid, metrics});
        sum_valid <= valid[PREDICTED-1];
        if (valid[PREDICTED-1]) begin
            sum_inverse <= metric[METRIC_BITS] ? '0 : ~metric[METRIC_BITS-1:0];
            // 24 and above are those with both upper bits, or with more
            misfit <= (against >> MISFIT_BITS) != 0 || &against[MISFIT_BITS-1:MISFIT_BITS-2]
                ? MISFIT_TOP : MISFIT_BITS'(against);
            place <= place + 1'b1;
        end
        if (begins) place <= '1;
        if (rst) begin
            valid     <= '0;
            sum_valid <= 1'b0;
        end
    end

    assign sum_last = place == PLACE_BITS'(PLACES - 1);

    wire unused = &{1'b0, product[SHIFT-1:0], farther, evidence, activity};
endmodule
