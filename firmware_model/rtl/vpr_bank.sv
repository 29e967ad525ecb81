// Place filter with several gains of the camera: a metric for each gain and place. It stands where
// vpr_filter stands for one gain, whose header says what the signals of both mean.
//
// A window takes passes. For each sum of newest windows that a gain looks at (vpr_speed), from the sum
// of four on: one over its distances, which come behind `compare_o`, for their mean; one for their
// spread; and one over the places for each of its gains, from the highest on, in which metrics of this
// window take the place of those before: the prediction plus the evidence, saturated. A pause has the
// passes of gains alone. Two more go through all metrics of a place: UP takes changes to the next
// higher gain, and hands the search the least metric of the place; DOWN takes changes to the next
// lower one, behind the match. Until its end the unit is not `idle_o`.
//
// A row of the memory has the metrics of a place, inverted, from the lowest gain on, and the least of
// them (LEAST_LANE). The row behind the last place has the least metric of each gain over all places
// (LEAST_ROW), from which restarts begin: changes of gain are the same for it. A pass begins with that
// row. The memory has one port: it is read in every other clock, and written between.
//
// The residual is that of the best place, with the first gain that has its metric. As gains come from
// the highest on, a metric is better if it is lower, or as low and of no higher place.
module vpr_bank #(
    localparam int PLACES          = vpr_pkg::PLACES,
    localparam int GAINS           = vpr_pkg::GAINS,
    localparam int SUMS            = vpr_pkg::SUMS,
    localparam int STEPS           = vpr_pkg::STEPS,
    localparam int PLACE_BITS      = vpr_pkg::PLACE_BITS,
    localparam int DISTANCE_BITS   = vpr_pkg::BIASED_BITS,
    localparam int RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS,
    localparam int COST_BITS       = vpr_pkg::COST_BITS,
    localparam int EVIDENCE_BITS   = vpr_pkg::EVIDENCE_BITS,
    localparam int METRIC_BITS     = vpr_pkg::METRIC_BITS,
    localparam int RESIDUAL_BITS   = vpr_pkg::RESIDUAL_BITS,
    parameter      MEMORY_STYLE    = "auto",  // of the metrics, see vpr_ram_single
    parameter  bit LOADABLE        = 0
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
    output logic                     compare_o,
    output logic [1:0]               sum_o,  // 2, 1, 0: of four windows, of two, of one
    input  logic                     distance_valid_i,
    input  logic [DISTANCE_BITS-1:0] distance_i,
    output logic                     least_valid_o,
    output logic                     least_last_o,
    output logic [PLACE_BITS-1:0]    place_o,
    output logic [METRIC_BITS-1:0]   least_o,
    output logic [RESIDUAL_BITS-1:0] residual_o,
    input  logic                     ends_i,
    input  logic [PLACE_BITS-1:0]    best_i,
    input  logic [METRIC_BITS-1:0]   best_sum_i,
    output logic [PLACE_BITS-1:0]    told_o
);
    localparam int ROW_BITS   = $clog2(PLACES + 1);
    localparam int LANE_BITS  = 3;
    localparam int SCALE_BITS = RECIPROCAL_BITS + 1;  // whether there is one, and as of vpr_spread
    // from a place to its prediction; the evidence takes a step less
    localparam int PREDICTED  = 3 + $clog2(STEPS + 1);
    localparam int BEST_BITS  = METRIC_BITS + PLACE_BITS;

    localparam logic [ROW_BITS-1:0]    LEAST_ROW   = ROW_BITS'(PLACES);
    localparam logic [LANE_BITS-1:0]   LEAST_LANE  = LANE_BITS'(GAINS);
    localparam logic [METRIC_BITS-1:0] GAIN_CHANGE = METRIC_BITS'(24);

    localparam logic [2:0] IDLE       = 3'd0;
    localparam logic [2:0] CHOOSE     = 3'd1;  // the next pass
    localparam logic [2:0] FOR_MEAN   = 3'd2;
    localparam logic [2:0] FOR_SPREAD = 3'd3;
    localparam logic [2:0] OF_GAIN    = 3'd4;
    localparam logic [2:0] UP         = 3'd5;
    localparam logic [2:0] TELL       = 3'd6;  // what is best, see vpr_middle
    localparam logic [2:0] DOWN       = 3'd7;

    logic [2:0]           state_q;
    logic                 waiting_q, beat_q, ready;
    logic [ROW_BITS-1:0]  row_q, written_row_q;
    logic [LANE_BITS-1:0] lane_q, written_lane_q;  // the gain, but for the LEAST_LANE

    // 1. See: what the number of events says

    logic                 placed_q;  // since reset there was a best place
    logic [7:0]           of_place;
    logic                 is_best, has_few, stands;
    logic [3:0]           weight;
    logic [LANE_BITS-1:0] gain_q;    // of the best place
    logic [3:0]           rank, rank_q;

    vpr_see see (
        .clk_i(clk_i), .rst_i(rst_i), .is_best_i(is_best), .of_place_i(of_place),
        .slack_i({gain_q[2] ? 4'd6 : 4'd10 - 4'(gain_q[1:0]), 3'd7}), .placed_i(placed_q),
        .paused_i(paused_i), .settled_i(settled_i), .activity_inverse_i(activity_inverse_i),
        .weight_o(weight), .has_few_o(has_few), .stands_o(stands)
    );

    vpr_speed speed (
        .clk_i(clk_i), .rst_i(rst_i), .settled_i(settled_i), .has_few_i(has_few),
        .activity_inverse_i(activity_inverse_i), .ready_o(ready), .rank_o(rank)
    );

    // Passes

    logic ends_q, divides_q, divide_q, dividing_q, done;
    logic measured_q;  // the sum
    // of metrics: the pass ends, a row was written
    logic pass_ends_q, moves_row;
    logic visits, visited_q;  // places around the best, see vpr_middle

    wire of_distances = state_q == FOR_MEAN || state_q == FOR_SPREAD;
    wire of_metrics   = state_q == OF_GAIN || state_q == UP || state_q == DOWN;
    wire runs         = (of_distances && !dividing_q) || of_metrics;
    wire item         = runs && (state_q == FOR_MEAN ? distance_valid_i : beat_q);
    wire last_lane    = state_q == OF_GAIN || lane_q == (state_q == UP ? LEAST_LANE : '0);

    wire [1:0] looks     = rank_q > 4'd2 ? 2'd2 : rank_q > 4'd0 ? 2'd1 : 2'd0;
    wire       gains_end = lane_q == LEAST_LANE;  // below the lowest
    // A choice takes two clocks. Registers take in the first: the sum is done, or no gain looks at it (below
    // the last it is 3); the sum has no mean and spread yet; all gains are done
    logic      chosen_q, next_sum_q, measures_q, gains_end_q;

    assign idle_o = state_q == IDLE && !waiting_q;

    always_ff @(posedge clk_i) begin
        chosen_q    <= state_q == CHOOSE && !chosen_q;
        next_sum_q  <= state_q == CHOOSE && !chosen_q && !paused_i && sum_o != 2'd3
                       && (gains_end || looks != sum_o);
        measures_q  <= !paused_i && !measured_q && !gains_end;
        gains_end_q <= gains_end;
        waiting_q  <= start_i || (waiting_q && state_q == IDLE && !(settled_i && ready));
        beat_q     <= runs && !beat_q;
        ends_q     <= item && of_distances && row_q == ROW_BITS'(PLACES - 1);
        divides_q  <= ends_q;
        divide_q   <= divides_q;
        dividing_q <= ends_q || (dividing_q && !done);
        compare_o  <= 1'b0;
        if (item && (of_distances || last_lane)) row_q <= row_q == LEAST_ROW ? '0 : row_q + 1'b1;
        case (state_q)
            IDLE: begin
                sum_o      <= 2'(SUMS - 1);
                lane_q     <= LEAST_LANE - 1'b1;
                rank_q     <= rank;
                measured_q <= 1'b0;
                if (waiting_q && settled_i && ready) state_q <= CHOOSE;
            end
            CHOOSE: begin
                row_q         <= measures_q ? '0 : LEAST_ROW;
                written_row_q <= gains_end_q ? LEAST_ROW : '0;
                if (next_sum_q) begin
                    sum_o      <= sum_o - 1'b1;
                    measured_q <= 1'b0;
                end else if (chosen_q && gains_end_q) begin
                    lane_q  <= '0;
                    state_q <= UP;
                end else if (chosen_q) begin
                    compare_o <= measures_q;
                    state_q   <= measures_q ? FOR_MEAN : OF_GAIN;
                end
            end
            FOR_MEAN, FOR_SPREAD: if (dividing_q) begin
                row_q <= '0;
                if (done) begin
                    measured_q <= state_q == FOR_SPREAD;
                    state_q    <= state_q == FOR_MEAN ? FOR_SPREAD : CHOOSE;
                end
            end
            OF_GAIN: if (pass_ends_q) begin
                lane_q  <= lane_q - 1'b1;
                rank_q  <= rank_q == 0 ? '0 : rank_q - 1'b1;
                state_q <= CHOOSE;
            end
            UP: begin
                if (beat_q) lane_q <= lane_q + 1'b1;
                if (pass_ends_q) state_q <= TELL;
            end
            TELL: begin
                row_q         <= LEAST_ROW;
                written_row_q <= LEAST_ROW;
                lane_q        <= LEAST_LANE;
                if (visited_q && !visits) state_q <= DOWN;
            end
            default: begin
                if (beat_q) lane_q <= lane_q - 1'b1;
                if (pass_ends_q) state_q <= IDLE;
            end
        endcase
        if (moves_row) written_row_q <= written_row_q == LEAST_ROW ? '0 : written_row_q + 1'b1;
        if (rst_i) begin
            state_q    <= IDLE;
            next_sum_q <= 1'b0;
            waiting_q  <= 1'b0;
            ends_q     <= 1'b0;
            divides_q  <= 1'b0;
            divide_q   <= 1'b0;
            dividing_q <= 1'b0;
            compare_o  <= 1'b0;
        end
    end

    // 3. Evidence: each sum has a reciprocal of its own, from the window before if that had one

    logic [DISTANCE_BITS-1:0]   kept, here_q, nearest_inverse_q;
    logic                       nearer_q, deviates_q, has_spread, whole;
    logic [RECIPROCAL_BITS-2:0] factor;
    logic [SUMS*SCALE_BITS-1:0] scales_q;  // of this sum, of the next, and of the one behind it
    logic [SCALE_BITS-2:0]      scale_q;
    logic [EVIDENCE_BITS-1:0]   against;
    logic [RESIDUAL_BITS-1:0]   residual;

    // the carry says that it is above the nearest
    wire [DISTANCE_BITS:0] farther = {1'b0, distance_i} + {1'b0, nearest_inverse_q};

    always_ff @(posedge clk_i) begin
        here_q     <= state_q == FOR_MEAN ? distance_i : kept;
        nearer_q   <= distance_valid_i && !farther[DISTANCE_BITS];
        deviates_q <= item && of_distances;
        if (compare_o) nearest_inverse_q <= '0;
        else if (nearer_q) nearest_inverse_q <= ~here_q;
        if (done) scale_q <= scales_q[SCALE_BITS-1] ? scales_q[SCALE_BITS-2:0] : {whole, factor};
        if (next_sum_q)
            scales_q <= {measured_q, {whole, factor} & {SCALE_BITS - 1{measured_q}},
                         scales_q[SUMS*SCALE_BITS-1:SCALE_BITS]};
        if (rst_i) begin
            deviates_q <= 1'b0;
            scales_q   <= '0;
        end
    end

    vpr_spread spread (
        .clk_i(clk_i), .rst_i(rst_i), .clear_i(compare_o), .valid_i(deviates_q), .distance_i(here_q),
        .of_mean_i(state_q == FOR_MEAN), .divide_i(divide_q), .done_o(done),
        .has_spread_o(has_spread), .whole_o(whole), .factor_o(factor)
    );

    vpr_ram #(
        .DEPTH(PLACES), .BITS(DISTANCE_BITS), .ADDRESS_BITS(PLACE_BITS)
    ) distances (
        .clk_i(clk_i), .write_i(item && state_q == FOR_MEAN), .write_address_i(PLACE_BITS'(row_q)),
        .write_word_i(distance_i), .read_i(1'b1), .read_address_i(PLACE_BITS'(row_q)),
        .read_word_o(kept)
    );

    vpr_evidence evidence (
        .clk_i(clk_i), .paused_i(paused_i), .distance_i(here_q),
        .nearest_inverse_i(nearest_inverse_q), .whole_i(scale_q[SCALE_BITS-2]),
        .factor_i(scale_q[SCALE_BITS-3:0]), .weight_i(weight), .against_o(against),
        .residual_o(residual)
    );

    // 2. Predict, from the metrics of the window before, with a gain

    logic [PLACE_BITS-1:0]      visited;
    logic                       based_q;  // the LEAST_ROW was read
    // the least metric of the gain, or behind the search that of all; and that of all of the window before
    logic [METRIC_BITS-1:0]     base_q, least_q, offset_q;
    logic [METRIC_BITS-1:0]     former_inverse, above, prediction;
    logic [9:0]                 by_gain_q;  // the activity less the gain, inverted
    logic [STEPS*COST_BITS-1:0] costs;

    wire shift = beat_q && state_q == OF_GAIN && based_q;

    always_ff @(posedge clk_i) begin
        visited_q <= visits;
        based_q   <= state_q == OF_GAIN && (based_q || beat_q);
        by_gain_q <= activity_inverse_i + {7'(lane_q) - 7'd4, 3'd0};
        if (ends_i) base_q <= best_sum_i;
        else if (beat_q && state_q == OF_GAIN && !based_q) base_q <= ~former_inverse;
        if (ends_i) least_q <= best_sum_i;
        offset_q  <= placed_q ? base_q - least_q : '0;
        if (ends_i) placed_q <= 1'b1;
        if (rst_i) placed_q <= 1'b0;
    end

    vpr_step_costs #(.LOADABLE(LOADABLE)) step_costs (
        .clk_i(clk_i), .load_i(load_i), .load_address_i(load_address_i), .load_word_i(load_word_i),
        .activity_inverse_i(by_gain_q), .stands_i(stands),
        .place_i(visits ? visited : PLACE_BITS'(row_q)), .of_place_o(of_place), .costs_o(costs)
    );

    vpr_prediction predictions (
        .clk_i(clk_i), .clear_i(!based_q), .shift_i(shift), .metric_i(~former_inverse),
        .costs_i(costs), .placed_i(placed_q), .least_i(base_q), .above_o(above),
        .prediction_o(prediction)
    );

    // Metrics, as they are made or read (`value_inverse_q`), and as they are written: the same, or that of a
    // change of gain, or the least of those since the first of a pass or of a place

    logic [PREDICTED-1:0]     valid_q;
    logic                     has_value_q, writes_q, stays_q, takes_least_q, lower_q, better_q;
    logic                     first_q, row_ends_q;
    logic [EVIDENCE_BITS:0]   lifted_q;
    logic [METRIC_BITS-1:0]   value_inverse_q, lowest_q, raised_q;
    logic [RESIDUAL_BITS-1:0] residual_q;
    logic [BEST_BITS-1:0]     best_inverse_q;  // metric and place

    wire [EVIDENCE_BITS:0] metric = (EVIDENCE_BITS + 1)'(prediction) + lifted_q;
    wire                   loads  =
        state_q == OF_GAIN ? valid_q[PREDICTED-1] && based_q : beat_q && of_metrics;

    wire takes_least = state_q == OF_GAIN ? written_row_q == LEAST_ROW
                                          : state_q == UP && written_lane_q == LEAST_LANE;
    wire alone       = state_q == OF_GAIN || (state_q == UP ? written_lane_q == 0
                                                            : written_lane_q >= LEAST_LANE - 1'b1);
    wire first       = state_q == OF_GAIN ? first_q : written_lane_q == 0;
    // the carries say that the value is below, and that the best is better
    wire [METRIC_BITS:0] below_raised = {1'b0, raised_q} + {1'b0, value_inverse_q};
    wire [METRIC_BITS:0] below_lowest = {1'b0, lowest_q} + {1'b0, value_inverse_q};
    wire [BEST_BITS:0]   worse        =
        {1'b0, ~value_inverse_q, place_o} + {1'b0, best_inverse_q};
    wire [METRIC_BITS-1:0] written_inverse =
        takes_least_q ? ~lowest_q : stays_q ? value_inverse_q : ~raised_q;
    wire [METRIC_BITS:0] raised       = {1'b0, ~written_inverse} + {1'b0, GAIN_CHANGE};

    wire at_row_end = state_q == OF_GAIN || written_lane_q == (state_q == UP ? LEAST_LANE : '0);
    assign moves_row = state_q == OF_GAIN ? writes_q : row_ends_q;
    wire at_last_row = written_row_q == (state_q == OF_GAIN ? LEAST_ROW : ROW_BITS'(PLACES - 1));

    assign place_o       = PLACE_BITS'(written_row_q);
    assign least_o       = lowest_q;
    assign least_valid_o = writes_q && state_q == UP && written_lane_q == LEAST_LANE
                           && written_row_q != LEAST_ROW;
    assign least_last_o  = written_row_q == ROW_BITS'(PLACES - 1);

    always_ff @(posedge clk_i) begin
        valid_q     <= based_q ? PREDICTED'({valid_q, shift}) : '0;
        has_value_q <= loads && !pass_ends_q;
        writes_q    <= has_value_q;
        pass_ends_q <= has_value_q && at_row_end && at_last_row;
        // no search looks at the place any more
        row_ends_q  <= writes_q && at_row_end && state_q != OF_GAIN && !pass_ends_q;
        lifted_q    <= (EVIDENCE_BITS + 1)'(against) + (EVIDENCE_BITS + 1)'(offset_q);
        if (beat_q) written_lane_q <= lane_q;
        if (loads) begin
            value_inverse_q <= state_q != OF_GAIN ? former_inverse
                : |metric[EVIDENCE_BITS:METRIC_BITS] ? '0 : ~metric[METRIC_BITS-1:0];
            residual_q      <= residual;
        end
        if (has_value_q) begin
            takes_least_q <= takes_least;
            stays_q       <= alone || below_raised[METRIC_BITS];
            lower_q       <= !takes_least && (first || below_lowest[METRIC_BITS]);
        end
        first_q  <= state_q == CHOOSE || (first_q && !has_value_q);
        if (writes_q) raised_q <= raised[METRIC_BITS] ? '1 : raised[METRIC_BITS-1:0];
        if (writes_q && lower_q) lowest_q <= ~value_inverse_q;
        better_q <= has_value_q && state_q == OF_GAIN && !takes_least && !worse[BEST_BITS];
        if (state_q == IDLE) best_inverse_q <= '0;
        else if (better_q) begin
            best_inverse_q <= {value_inverse_q, ~place_o};
            gain_q         <= lane_q;
            residual_o     <= residual_q;
        end
        if (rst_i) begin
            has_value_q <= 1'b0;
            writes_q    <= 1'b0;
            pass_ends_q <= 1'b0;
            row_ends_q  <= 1'b0;
            better_q    <= 1'b0;
        end
    end

    wire [ROW_BITS-1:0] read_row = visits ? ROW_BITS'(visited) : row_q;

    vpr_ram_single #(
        .DEPTH((PLACES + 1) << LANE_BITS), .BITS(METRIC_BITS), .ADDRESS_BITS(ROW_BITS + LANE_BITS),
        .STYLE(MEMORY_STYLE)
    ) metrics (
        .clk_i(clk_i), .write_i(writes_q),
        .address_i(writes_q ? {written_row_q, written_lane_q} : {read_row, lane_q}),
        .write_word_i(written_inverse), .read_word_o(former_inverse)
    );

    // 4. What is told of the best place, which vpr_search finds. Trust: vpr_trust

    vpr_middle middle (
        .clk_i(clk_i), .rst_i(rst_i), .ends_i(ends_i), .best_i(best_i),
        .visits_o(visits), .place_o(visited), .above_i(above),
        .is_best_o(is_best), .told_o(told_o)
    );

    wire unused = &{1'b0, farther, has_spread, below_raised, below_lowest, worse};
endmodule
