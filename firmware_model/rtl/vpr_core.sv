// The place recogniser: events in, matches out, as docs/specification.md specifies it.
//
// All streams are AXI-Stream; a word is a line of the file of golden vectors with its name:
//   s_event   events.mem            s_place    places.mem, after reset, before the first match
//   m_event   expected_events.mem   m_window   expected_windows.mem, `tlast` with a window's last
//   m_match   expected_matches.mem             word, `tuser` the number of events before its end
// Leave unused outputs open with their tready at 1; they then cost nothing.
//
// `rst_i` is synchronous and resets all state but the places; the first window opens at `start_time_i`,
// which is read in its last clock, as is `start_activity_i`, the mean number of events in a window.
// s_event_tready rises TIMESTAMP_BITS + 1 clocks after it. Events are taken while a window is matched,
// after it was encoded; the end of a further window waits.
module vpr_core #(
    localparam bit PAUSES         = vpr_pkg::PAUSES,
    localparam bit FILTER         = vpr_pkg::FILTER,
    localparam int GAINS          = vpr_pkg::GAINS,
    localparam int EVENT_BITS     = vpr_pkg::EVENT_BITS,
    localparam int TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam int SLOT_BITS      = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS     = vpr_pkg::COUNT_BITS,
    localparam int SEEN_BITS      = vpr_pkg::SEEN_BITS,
    localparam int WORD_BITS      = vpr_pkg::WORD_BITS,
    localparam int BIASED_BITS    = vpr_pkg::BIASED_BITS,
    localparam int REACH          = vpr_pkg::REACH,
    localparam int SUM_BITS       = vpr_pkg::SUM_BITS,
    localparam int PLACE_BITS     = vpr_pkg::PLACE_BITS,
    localparam int ACTIVITY_BITS  = vpr_pkg::ACTIVITY_BITS,
    localparam int TRUST_BITS     = vpr_pkg::TRUST_BITS,
    localparam int MATCH_BITS     = vpr_pkg::MATCH_BITS,
    localparam logic [31:0] LARGEST_SUM = vpr_pkg::LARGEST_SUM,
    parameter      MEMORY_STYLE   = "auto",  // of places, past distances and metrics of several gains,
                                             // see vpr_ram_single
    parameter      PLACES_FILE    = "",      // of the places; they may be loaded instead
    parameter      LOADABLE       = 0,       // tables are loaded, in place of their files
    // where block memories take more than half a clock: counts and delay lines are not kept in
    // them, and entries of the look-up, the descriptor and places, and past distances have a
    // register behind them: an event takes a clock more, and a match one for each pass over places,
    // and one more with sequences of two and more
    parameter      SLOW_BLOCKS    = 0
) (
    input  logic                                   clk_i,
    input  logic                                   rst_i,

    // tables that are loaded before a reset (LOADABLE): displacement, lookup, levels, means,
    // place_activity, limits, place_bias
    input  logic [6:0]                             load_i,
    input  logic [19:0]                            load_address_i,
    input  logic [31:0]                            load_word_i,

    input  logic [TIMESTAMP_BITS-1:0]              start_time_i,
    input  logic [ACTIVITY_BITS-1:0]               start_activity_i,

    input  logic                                   s_place_tvalid,
    output logic                                   s_place_tready,
    input  logic [WORD_BITS-1:0]                   s_place_tdata,

    input  logic                                   s_event_tvalid,
    output logic                                   s_event_tready,
    input  logic [EVENT_BITS-1:0]                  s_event_tdata,

    output logic                                   m_event_tvalid,
    input  logic                                   m_event_tready,
    output logic [SEEN_BITS-1:0]                   m_event_tdata,

    output logic                                   m_window_tvalid,
    input  logic                                   m_window_tready,
    output logic [WORD_BITS-1:0]                   m_window_tdata,
    output logic                                   m_window_tlast,
    output logic [31:0]                            m_window_tuser,

    output logic                                   m_match_tvalid,
    input  logic                                   m_match_tready,
    output logic [MATCH_BITS-1:0]                  m_match_tdata
);
    // Events, and the descriptor of a window that ended

    logic                       busy_q;
    logic                       window_ready_q, window_end;
    logic [31:0]                events_taken;
    logic                       counted, paused, settled, pending_q;
    logic                       drain, draining;
    logic [SLOT_BITS-1:0]       drain_slot, drained_slot;
    logic [COUNT_BITS-1:0]      drained;
    logic [WORD_BITS-1:0]       place_word;
    logic [9:0]                 activity_inverse;
    // with several gains there is a descriptor for each sum of newest windows, the last for the window
    logic                       word_valid;
    logic [1:0]                 word_sum;

    vpr_events #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) events (
        .clk_i(clk_i), .rst_i(rst_i), .load_i({load_i[5], load_i[1:0]}), .load_address_i(load_address_i),
        .load_word_i(load_word_i),
        .start_time_i(start_time_i),
        .s_event_tvalid(s_event_tvalid), .s_event_tready(s_event_tready),
        .s_event_tdata(s_event_tdata),
        .m_event_tvalid(m_event_tvalid), .m_event_tready(m_event_tready),
        .m_event_tdata(m_event_tdata),
        .pending_i(pending_q), .window_ready_i(window_ready_q), .window_end_o(window_end),
        .events_taken_o(events_taken),
        .counted_o(counted),
        .draining_i(draining), .drain_i(drain), .drain_slot_i(drain_slot), .drained_o(drained),
        .drained_slot_o(drained_slot)
    );

    vpr_encoder #(.LOADABLE(LOADABLE)) encoder (
        .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[3:2]), .load_address_i(load_address_i),
        .load_word_i(load_word_i),
        .start_i(window_end), .paused_i(paused),
        .draining_o(draining), .drain_o(drain), .drain_slot_o(drain_slot), .drained_i(drained),
        .drained_slot_i(drained_slot),
        .word_valid_o(word_valid), .word_ready_i(m_window_tready || word_sum != 0),
        .word_last_o(m_window_tlast), .sum_o(word_sum), .word_o(m_window_tdata)
    );

    assign m_window_tvalid = word_valid && word_sum == 0;

    generate
        if (PAUSES) begin : g_pauses
            logic pauses;
            vpr_activity activity (
                .clk_i(clk_i), .load_i(rst_i), .start_activity_i(start_activity_i), .counted_i(counted),
                .window_end_i(window_end), .settled_o(settled), .pauses_o(pauses),
                .activity_inverse_o(activity_inverse)
            );
            always_ff @(posedge clk_i) if (window_end) paused <= pauses;
        end else begin : g_no_pauses
            wire unused = &{1'b0, start_activity_i, counted};
            assign paused  = 1'b0;
            assign settled = 1'b1;
            assign activity_inverse = '1;
        end
    endgenerate

    // Distances, sums, and the search

    logic [31:0]                   window_q;
    logic                          carries_q;  // the lower half of its next number into the upper
    logic                          begun_q, compare_q, filter_idle;
    logic                          compares;  // the descriptor of `sum_compared` to all places
    logic [1:0]                    sum_compared;
    logic                          place_step, place_last;
    logic                          distance_valid;
    logic [BIASED_BITS-1:0]        distance;
    logic                          sum_valid, sum_complete, sum_last;
    logic [PLACE_BITS-1:0]         place;
    logic [SUM_BITS-1:0]           sum;

    wire query_write = word_valid && (m_window_tready || word_sum != 0);

    vpr_place_memory #(.MEMORY_STYLE(MEMORY_STYLE), .FILE(PLACES_FILE)) place_memory (
        .clk_i(clk_i), .rst_i(rst_i), .busy_i(busy_q), .stop_i(window_end),
        .s_place_tvalid(s_place_tvalid), .s_place_tready(s_place_tready),
        .s_place_tdata(s_place_tdata),
        .start_i(begun_q || compares), .step_i(place_step), .last_o(place_last), .word_o(place_word)
    );

    vpr_distance #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) distances (
        .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[6]), .load_address_i(load_address_i),
        .load_word_i(load_word_i), .query_write_i(query_write), .query_inverse_i(~m_window_tdata),
        .written_sum_i(word_sum), .follow_i(compares), .sum_i(sum_compared),
        .place_step_o(place_step), .place_last_i(place_last), .place_word_i(place_word),
        .distance_valid_o(distance_valid), .distance_o(distance)
    );

    logic                became, has_best, has_second, ends_search;
    logic [PLACE_BITS-1:0] best, ties, second;
    logic [SUM_BITS-1:0]   best_sum, second_sum;
    logic [TRUST_BITS-1:0] trust;
    logic                  trusted;

    generate
        if (GAINS == 1) begin : g_follows
            assign compares     = begun_q && !(FILTER && paused);
            assign sum_compared = '0;
        end
        if (FILTER) begin : g_filter
            logic [4:0]            residual;
            logic [PLACE_BITS-1:0] told;

            if (GAINS > 1) begin : g_bank
                vpr_bank #(.MEMORY_STYLE(MEMORY_STYLE), .LOADABLE(LOADABLE)) bank (
                    .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[4]), .load_address_i(load_address_i),
                    .load_word_i(load_word_i), .start_i(compare_q), .paused_i(paused),
                    .settled_i(settled), .activity_inverse_i(activity_inverse), .idle_o(filter_idle),
                    .compare_o(compares), .sum_o(sum_compared), .distance_valid_i(distance_valid),
                    .distance_i(distance), .least_valid_o(sum_valid), .least_last_o(sum_last),
                    .place_o(place), .least_o(sum), .residual_o(residual), .ends_i(ends_search),
                    .best_i(best), .best_sum_i(best_sum), .told_o(told)
                );
            end else begin : g_one_gain
                vpr_filter #(.LOADABLE(LOADABLE)) place_filter (
                    .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[4]), .load_address_i(load_address_i),
                    .load_word_i(load_word_i), .start_i(compare_q), .paused_i(paused), .settled_i(settled),
                    .activity_inverse_i(activity_inverse), .idle_o(filter_idle),
                    .distance_valid_i(distance_valid), .distance_i(distance), .sum_valid_o(sum_valid), .sum_last_o(sum_last), .place_o(place),
                    .sum_o(sum), .residual_o(residual), .ends_i(ends_search), .best_i(best),
                    .best_sum_i(best_sum), .told_o(told)
                );
            end
            assign sum_complete = 1'b1;
            vpr_trust trust_in_matches (
                .clk_i(clk_i), .rst_i(rst_i), .became_i(became), .residual_i(residual),
                .update_i(ends_search),
                .best_i(best), .best_sum_i(best_sum), .has_second_i(has_second),
                .second_sum_i(second_sum), .trust_o(trust), .trusted_o(trusted)
            );
            assign m_match_tdata = {
                trust, has_second && trusted, ties, second_sum, second, has_second, best_sum, told,
                window_q
            };
        end else begin : g_sequence
            assign filter_idle    = 1'b1;
            vpr_sequence #(.MEMORY_STYLE(MEMORY_STYLE), .SLOW_BLOCKS(SLOW_BLOCKS)) sequence_sums (
                .clk_i(clk_i), .rst_i(rst_i), .start_i(compare_q),
                .distance_valid_i(distance_valid), .distance_i(distance),
                .sum_valid_o(sum_valid), .sum_complete_o(sum_complete), .sum_last_o(sum_last),
                .place_o(place), .sum_o(sum)
            );
            // registered at the clock edge behind the last sum's two of the search
            logic accepted_q;
            always_ff @(posedge clk_i) accepted_q <= 64'(best_sum) <= 64'(LARGEST_SUM);
            assign trust   = '0;
            assign trusted = 1'b1;
            wire unused = &{1'b0, trust, trusted, became, ends_search, activity_inverse, load_i[4]};
            assign m_match_tdata = {
                accepted_q, ties, second_sum, second, has_second, best_sum, best, window_q
            };
        end
    endgenerate

    vpr_search #(.SLOW_BLOCKS(SLOW_BLOCKS)) search (
        .clk_i(clk_i), .rst_i(rst_i), .start_i(compare_q),
        .sum_valid_i(sum_valid && sum_complete), .place_i(place), .sum_i(sum), .became_o(became),
        .has_best_o(has_best),
        .best_o(best), .best_sum_o(best_sum), .ties_o(ties),
        .has_second_o(has_second), .second_o(second), .second_sum_o(second_sum)
    );

    // A window at a time: from its end until its match is taken, or there is none

    // the search's two clocks, and the first of the acceptance test; the trust takes ten more, and
    // the middle of places that are told twelve
    localparam int FINISHING = !FILTER ? 3 : REACH == 0 ? 13 : 2 * REACH + 7;

    logic [FINISHING-1:0] finishing_q;

    wire finished = finishing_q[FINISHING-1];
    assign ends_search = finishing_q[1];

    wire match_taken = m_match_tvalid && m_match_tready;

    always_ff @(posedge clk_i) begin
        carries_q   <= &window_q[15:0];
        begun_q     <= window_end;
        compare_q   <= query_write && m_window_tlast && word_sum == 0;
        finishing_q <= FINISHING'({finishing_q, sum_valid && sum_last});
        if (finished) m_match_tvalid <= has_best;
        else if (match_taken) m_match_tvalid <= 1'b0;
        if (window_end) begin
            busy_q           <= 1'b1;
            window_q[15:0]   <= window_q[15:0] + 1'b1;
            if (carries_q) window_q[31:16] <= window_q[31:16] + 1'b1;
            m_window_tuser <= events_taken;
        end else if (match_taken || (finished && !has_best)) busy_q <= 1'b0;
        // no event is counted while the last window's counts are drained, or its number of events used
        pending_q      <= window_end || draining || !settled;
        // behind a reset, the first window may end before all counters are drained
        window_ready_q <= !busy_q && !window_end && !draining && settled && filter_idle;
        if (rst_i) begin
            begun_q          <= 1'b0;
            pending_q        <= 1'b1;
            compare_q        <= 1'b0;
            finishing_q      <= '0;
            m_match_tvalid <= 1'b0;
            busy_q           <= 1'b0;
            window_q         <= '1;
        end
    end
endmodule
