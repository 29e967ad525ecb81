// Place filter: a metric for every place, advanced window by window: what the number of events says
// (vpr_see), evidence, prediction, and of the best place, which the search finds, the middle of the
// places near it that is told (vpr_middle). It stands where vpr_sequence stands for sequences, and
// hands the search a metric of each place in their order.
//
// A window takes passes over all places: for the mean of the distances; for their spread, unless it
// is known from the window before; and for the metrics, each the prediction plus the evidence,
// saturated. Distances come in the first pass, some clocks after `start_i`, and are kept for the
// others. In a pause there is no evidence, and there are no distances. The spread of this window is
// divided after its match; until then the unit is not `idle_o`, and no window may end. No pass for
// metrics begins before the window's activity stands (`settled_i`): it says what the evidence weighs,
// and what steps cost.
//
// `residual_o` is the evidence that the metric has, saturated at RESIDUAL_TOP. `ends_i` says that
// the search stands at `best_i` and `best_sum_i`, the least metric; `told_o` follows, see vpr_middle.
// Distances come two clocks apart at least, and so do metrics.
module vpr_filter #(
    localparam int           PLACES          = vpr_pkg::PLACES,
    localparam int           STEPS           = vpr_pkg::STEPS,
    localparam int           PLACE_BITS      = vpr_pkg::PLACE_BITS,
    localparam int           DISTANCE_BITS   = vpr_pkg::BIASED_BITS,
    localparam int           RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS,
    localparam int           COST_BITS       = vpr_pkg::COST_BITS,
    localparam int           EVIDENCE_BITS   = vpr_pkg::EVIDENCE_BITS,
    localparam int           METRIC_BITS     = vpr_pkg::METRIC_BITS,
    localparam int           RESIDUAL_BITS   = vpr_pkg::RESIDUAL_BITS,
    parameter  bit           LOADABLE        = 0
) (
    input  logic                     clk_i,
    input  logic                     rst_i,
    input  logic                     load_i,  // see vpr_rom
    input  logic [19:0]              load_address_i,
    input  logic [31:0]              load_word_i,
    input  logic                     start_i,
    input  logic                     paused_i,
    input  logic                     settled_i,
    input  logic [9:0]               activity_inverse_i,
    output logic                     idle_o,
    input  logic                     distance_valid_i,
    input  logic [DISTANCE_BITS-1:0] distance_i,
    output logic                     sum_valid_o,
    output logic                     sum_last_o,
    output logic [PLACE_BITS-1:0]    place_o,
    output logic [METRIC_BITS-1:0]   sum_o,
    output logic [RESIDUAL_BITS-1:0] residual_o,
    input  logic                     ends_i,
    input  logic [PLACE_BITS-1:0]    best_i,
    input  logic [METRIC_BITS-1:0]   best_sum_i,
    output logic [PLACE_BITS-1:0]    told_o
);
    // from a place's distance to its prediction by 6 steps; the evidence takes 5, and stays for 2
    localparam int PREDICTED     = 3 + $clog2(STEPS + 1);

    localparam logic [1:0] IDLE   = 2'd0;
    localparam logic [1:0] RUN    = 2'd1;
    localparam logic [1:0] DIVIDE = 2'd2;

    localparam logic [1:0] FOR_MEAN    = 2'd0;
    localparam logic [1:0] FOR_SPREAD  = 2'd1;
    localparam logic [1:0] FOR_METRICS = 2'd2;

    logic [1:0]                 state_q, pass_q;
    logic                       settled_q, waiting_q, beat_q, ends_q, divides_q, divide_q, done;
    logic                       scaled_q;  // by the spread of this window
    logic [PLACE_BITS-1:0]      index_q;
    logic [DISTANCE_BITS-1:0]   kept, nearest_inverse_q;
    // a clock behind the place, as memory gives it late
    logic                       nearer_q, deviates_q;
    logic [DISTANCE_BITS-1:0]   here_q;
    logic                       has_spread, whole;
    logic [RECIPROCAL_BITS-2:0] factor;  // see vpr_spread

    // A place: its distance comes from the distance unit, or later from memory
    wire                     comes     = pass_q == FOR_MEAN;
    wire                     item      = state_q == RUN && (comes ? distance_valid_i : beat_q);
    // the carry says that it is above the nearest
    wire [DISTANCE_BITS:0]   farther   = {1'b0, distance_i} + {1'b0, nearest_inverse_q};
    wire                     item_last = index_q == PLACE_BITS'(PLACES - 1);
    wire                     begins    = waiting_q;  // it is idle when a window begins
    assign idle_o = state_q == IDLE && !waiting_q;
    // the next pass: one after the mean, unless this window's own spread is needed first
    wire [1:0]               pass_d =
        pass_q == FOR_MEAN && !has_spread ? FOR_SPREAD : FOR_METRICS;

    always_ff @(posedge clk_i) begin
        // behind what the number of events says, see vpr_see
        settled_q        <= settled_i;
        waiting_q        <= start_i || (waiting_q && paused_i && !settled_q);
        beat_q           <= state_q == RUN && !beat_q;
        here_q           <= comes ? distance_i : kept;
        nearer_q         <= distance_valid_i && comes && !farther[DISTANCE_BITS];
        deviates_q       <= item && !paused_i;
        divides_q        <= 1'b0;
        divide_q         <= divides_q;
        ends_q           <= (item && item_last) || (ends_q && !settled_i);
        case (state_q)
            IDLE: begin
                pass_q <= paused_i ? FOR_METRICS : FOR_MEAN;
                if (waiting_q && (!paused_i || settled_q)) state_q <= RUN;
            end
            RUN: if (ends_q && settled_i) begin
                state_q   <= paused_i || scaled_q ? IDLE : DIVIDE;
                divides_q <= !paused_i && !scaled_q;
            end
            default: if (done) begin
                pass_q   <= pass_d;
                scaled_q <= pass_q == FOR_SPREAD;
                state_q  <= pass_q == FOR_METRICS ? IDLE : RUN;
            end
        endcase
        if (state_q == IDLE || state_q == DIVIDE) index_q <= '0;
        else if (item && !item_last) index_q <= index_q + 1'b1;
        if (begins) scaled_q <= 1'b0;
        if (begins) nearest_inverse_q <= '0;
        else if (nearer_q) nearest_inverse_q <= ~here_q;
        if (rst_i) begin
            state_q    <= IDLE;
            waiting_q  <= 1'b0;
            ends_q     <= 1'b0;
            deviates_q <= 1'b0;
            divides_q  <= 1'b0;
            divide_q   <= 1'b0;
        end
    end

    vpr_spread scale (
        .clk_i(clk_i), .rst_i(rst_i), .clear_i(begins), .valid_i(deviates_q), .distance_i(here_q),
        .of_mean_i(pass_q == FOR_MEAN), .divide_i(divide_q), .done_o(done),
        .has_spread_o(has_spread), .whole_o(whole), .factor_o(factor)
    );

    vpr_ram #(
        .DEPTH(PLACES), .BITS(DISTANCE_BITS), .ADDRESS_BITS(PLACE_BITS)
    ) distances (
        .clk_i(clk_i), .write_i(item && comes && !paused_i), .write_address_i(index_q),
        .write_word_i(distance_i), .read_i(1'b1), .read_address_i(index_q), .read_word_o(kept)
    );

    // 1. See: what the number of events says

    logic       placed_q;  // since reset there was a best place
    logic [7:0] of_place;
    logic       is_best, has_few, stands;
    logic [3:0] weight;

    always_ff @(posedge clk_i) begin
        if (ends_i) placed_q <= 1'b1;
        if (rst_i) placed_q <= 1'b0;
    end

    vpr_see see (
        .clk_i(clk_i), .rst_i(rst_i), .is_best_i(is_best), .of_place_i(of_place), .slack_i(7'd55),
        .placed_i(placed_q), .paused_i(paused_i), .settled_i(settled_i),
        .activity_inverse_i(activity_inverse_i), .weight_o(weight), .has_few_o(has_few),
        .stands_o(stands)
    );

    // 3. Evidence

    logic [EVIDENCE_BITS-1:0] against;
    logic [RESIDUAL_BITS-1:0] residual;

    vpr_evidence evidence (
        .clk_i(clk_i), .paused_i(paused_i), .distance_i(here_q),
        .nearest_inverse_i(nearest_inverse_q), .whole_i(whole), .factor_i(factor), .weight_i(weight),
        .against_o(against), .residual_o(residual)
    );

    // 2. Predict, from the metrics of the window before

    logic                       visits;  // behind the search, of places around the best
    logic [PLACE_BITS-1:0]      visited;
    logic [METRIC_BITS-1:0]     least_q, former_inverse, above, prediction, sum_inverse_q;
    logic [STEPS*COST_BITS-1:0] costs;

    wire [PLACE_BITS-1:0] place   = visits ? visited : index_q;
    wire                  metrics = item && pass_q == FOR_METRICS;

    always_ff @(posedge clk_i) if (ends_i) least_q <= best_sum_i;

    vpr_ram #(
        .DEPTH(PLACES), .BITS(METRIC_BITS), .ADDRESS_BITS(PLACE_BITS)
    ) metric_memory (
        .clk_i(clk_i), .write_i(sum_valid_o), .write_address_i(place_o), .write_word_i(sum_inverse_q),
        .read_i(1'b1), .read_address_i(place), .read_word_o(former_inverse)
    );

    vpr_step_costs #(.LOADABLE(LOADABLE)) step_costs (
        .clk_i(clk_i), .load_i(load_i), .load_address_i(load_address_i), .load_word_i(load_word_i),
        .activity_inverse_i(activity_inverse_i), .stands_i(stands), .place_i(place),
        .of_place_o(of_place), .costs_o(costs)
    );

    vpr_prediction predictions (
        .clk_i(clk_i), .clear_i(state_q == IDLE || state_q == DIVIDE), .shift_i(metrics),
        .metric_i(~former_inverse), .costs_i(costs), .placed_i(placed_q),
        .least_i(least_q), .above_o(above), .prediction_o(prediction)
    );

    // 4. Metrics, for the best place, which vpr_search finds; and what is told of it. Trust: vpr_trust

    logic [PREDICTED-1:0] valid_q;

    wire [EVIDENCE_BITS:0] metric = (EVIDENCE_BITS + 1)'(prediction) + (EVIDENCE_BITS + 1)'(against);

    assign sum_o      = ~sum_inverse_q;  // in memory as the search compares it
    assign sum_last_o = place_o == PLACE_BITS'(PLACES - 1);

    always_ff @(posedge clk_i) begin
        valid_q     <= PREDICTED'({valid_q, metrics});
        sum_valid_o <= valid_q[PREDICTED-1];
        if (valid_q[PREDICTED-1]) begin
            sum_inverse_q <= |metric[EVIDENCE_BITS:METRIC_BITS] ? '0 : ~metric[METRIC_BITS-1:0];
            residual_o    <= residual;
            place_o       <= place_o + 1'b1;
        end
        if (begins) place_o <= '1;
        if (rst_i) begin
            valid_q     <= '0;
            sum_valid_o <= 1'b0;
        end
    end

    vpr_middle middle (
        .clk_i(clk_i), .rst_i(rst_i), .ends_i(ends_i), .best_i(best_i),
        .visits_o(visits), .place_o(visited), .above_i(above),
        .is_best_o(is_best), .told_o(told_o)
    );

    wire unused = &{1'b0, farther, has_few};
endmodule
