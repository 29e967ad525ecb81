// The place recogniser: events in, matches out, as docs/specification.md specifies it.
//
// All streams are AXI-Stream; a word is a line of the file of golden vectors with its name:
//   s_event   events.mem            s_place    places.mem, after reset, before the first match
//   m_event   expected_events.mem   m_window   expected_windows.mem, `tlast` with a window's last
//   m_match   expected_matches.mem             word, `tuser` the number of events before its end
// Outputs that are of no use are left open with their tready at 1, and cost nothing.
//
// `rst` is synchronous and begins anew but for the places; the first window opens at `start_time`,
// which is read in its last clock, as is `start_activity`, the usual number of events in a window.
// s_event_tready rises TIMESTAMP_BITS + 1 clocks after it. Events are taken while a window is matched,
// after it was encoded; the end of a further window waits.
module vpr_core #(
    localparam bit PAUSES         = vpr_pkg::PAUSES,
    localparam bit FILTER         = vpr_pkg::FILTER,
    localparam int EVENT_BITS     = vpr_pkg::EVENT_BITS,
    localparam int TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam int SLOT_BITS      = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS     = vpr_pkg::COUNT_BITS,
    localparam int SEEN_BITS      = vpr_pkg::SEEN_BITS,
    localparam int WORD_BITS      = vpr_pkg::WORD_BITS,
    localparam int DISTANCE_BITS  = vpr_pkg::DISTANCE_BITS,
    localparam int SUM_BITS       = vpr_pkg::SUM_BITS,
    localparam int PLACE_BITS     = vpr_pkg::PLACE_BITS,
    localparam int ACTIVITY_BITS  = vpr_pkg::ACTIVITY_BITS,
    localparam int TRUST_BITS     = vpr_pkg::TRUST_BITS,
    localparam int MATCH_BITS     = vpr_pkg::MATCH_BITS,
    parameter      MEMORY_STYLE   = "auto",  // of places and past distances, see vpr_ram_single
    parameter      PLACES_FILE    = "",      // of the places; they may be loaded instead
    parameter      LOADABLE       = 0,       // tables are loaded, in place of their files
    // where block memories take more than half a clock: counts and delay lines are not kept in
    // them, and entries of the look-up, the descriptor and places, and past distances have a
    // register behind them: an event takes a clock more, and a match one for each pass over places,
    // and one more with sequences of two and more
    parameter      SLOW_BLOCKS    = 0
) (
    input  logic                                   clk,
    input  logic                                   rst,

    // tables that are loaded before a reset (LOADABLE): displacement, lookup, codes, code_tables, means,
    // place_activity
    input  logic [5:0]                             load,
    input  logic [19:0]                            load_address,
    input  logic [31:0]                            load_word,

    input  logic [TIMESTAMP_BITS-1:0]              start_time,
    input  logic [ACTIVITY_BITS-1:0]               start_activity,

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

    logic                       busy;
    logic                       window_ready, window_end;
    logic [31:0]                events_taken;
    logic                       counted, paused, settled, pending;
    logic                       drain, draining;
    logic [SLOT_BITS-1:0]       drain_slot, drained_slot;
    logic [COUNT_BITS-1:0]      drained;
    logic [WORD_BITS-1:0]       place_word;
    logic [9:0]                 activity_inverse;

    vpr_events #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) events (
        .clk(clk), .rst(rst), .load(load[1:0]), .load_address(load_address), .load_word(load_word),
        .start_time(start_time),
        .s_event_tvalid(s_event_tvalid), .s_event_tready(s_event_tready),
        .s_event_tdata(s_event_tdata),
        .m_event_tvalid(m_event_tvalid), .m_event_tready(m_event_tready),
        .m_event_tdata(m_event_tdata),
        .pending(pending), .window_ready(window_ready), .window_end(window_end), .events_taken(events_taken),
        .counted(counted),
        .draining(draining), .drain(drain), .drain_slot(drain_slot), .drained(drained),
        .drained_slot(drained_slot)
    );

    vpr_encoder #(.LOADABLE(LOADABLE)) encoder (
        .clk(clk), .rst(rst), .load(load[4:2]), .load_address(load_address), .load_word(load_word),
        .start(window_end), .paused(paused),
        .draining(draining), .drain(drain), .drain_slot(drain_slot), .drained(drained),
        .drained_slot(drained_slot),
        .word_valid(m_window_tvalid), .word_ready(m_window_tready),
        .word_last(m_window_tlast), .word(m_window_tdata)
    );

    generate
        if (PAUSES) begin : g_pauses
            logic pauses;
            vpr_activity activity (
                .clk(clk), .load(rst), .start_activity(start_activity), .counted(counted),
                .window_end(window_end), .settled(settled), .pauses(pauses),
                .activity_inverse(activity_inverse)
            );
            always_ff @(posedge clk) if (window_end) paused <= pauses;
        end else begin : g_no_pauses
            wire unused = &{1'b0, start_activity, counted};
            assign paused  = 1'b0;
            assign settled = 1'b1;
            assign activity_inverse = '1;
        end
    endgenerate

    // Distances, sums, and the search

    logic [31:0]                   window;
    logic                          begun, compare, distance_start, filter_idle;
    logic                          place_step, place_last;
    logic                          distance_valid;
    logic [DISTANCE_BITS-1:0]      distance;
    logic                          sum_valid, sum_complete, sum_last;
    logic [PLACE_BITS-1:0]         place;
    logic [SUM_BITS-1:0]           sum;

    wire query_write = m_window_tvalid && m_window_tready;

    vpr_place_memory #(.MEMORY_STYLE(MEMORY_STYLE), .FILE(PLACES_FILE)) place_memory (
        .clk(clk), .rst(rst), .busy(busy), .stop(window_end),
        .s_place_tvalid(s_place_tvalid), .s_place_tready(s_place_tready),
        .s_place_tdata(s_place_tdata),
        .start(begun), .step(place_step), .last(place_last), .word(place_word)
    );

    vpr_distance #(.SLOW_BLOCKS(SLOW_BLOCKS)) distances (
        .clk(clk), .rst(rst), .query_write(query_write), .query_inverse(~m_window_tdata),
        .follow(begun && !(FILTER && paused)), .start(distance_start), .place_step(place_step), .place_last(place_last), .place_word(place_word),
        .distance_valid(distance_valid), .distance(distance)
    );

    logic                became, has_best, has_second, accepted, ends_search;
    logic [PLACE_BITS-1:0] best, ties, second;
    logic [SUM_BITS-1:0]   best_sum, second_sum;
    logic [TRUST_BITS-1:0] trust;
    logic                  trusted;

    generate
        if (FILTER) begin : g_filter
            logic [4:0] misfit;

            vpr_filter #(.LOADABLE(LOADABLE)) place_filter (
                .clk(clk), .rst(rst), .load(load[5]), .load_address(load_address),
                .load_word(load_word), .start(compare), .paused(paused), .settled(settled),
                .activity_inverse(activity_inverse), .idle(filter_idle),
                .distance_start(distance_start), .distance_valid(distance_valid),
                .distance(distance), .sum_valid(sum_valid), .sum_last(sum_last), .place(place),
                .sum(sum), .misfit(misfit), .found(ends_search), .best_sum(best_sum)
            );
            assign sum_complete = 1'b1;
            vpr_trust trust_in_matches (
                .clk(clk), .rst(rst), .became(became), .misfit(misfit), .update(ends_search),
                .best(best), .best_sum(best_sum), .has_second(has_second),
                .second_sum(second_sum), .trust(trust), .trusted(trusted)
            );
            assign m_match_tdata = {
                trust, accepted && trusted, ties, second_sum, second, has_second, best_sum, best,
                window
            };
        end else begin : g_sequence
            assign distance_start = 1'b0;
            assign filter_idle    = 1'b1;
            vpr_sequence #(.MEMORY_STYLE(MEMORY_STYLE), .SLOW_BLOCKS(SLOW_BLOCKS)) sequence_sums (
                .clk(clk), .rst(rst), .start(compare),
                .distance_valid(distance_valid), .distance(distance),
                .sum_valid(sum_valid), .sum_complete(sum_complete), .sum_last(sum_last),
                .place(place), .sum(sum)
            );
            assign trust   = '0;
            assign trusted = 1'b1;
            wire unused = &{1'b0, trust, trusted, became, ends_search, activity_inverse, load[5]};
            assign m_match_tdata = {
                accepted, ties, second_sum, second, has_second, best_sum, best, window
            };
        end
    endgenerate

    vpr_search #(.SLOW_BLOCKS(SLOW_BLOCKS)) search (
        .clk(clk), .rst(rst), .start(compare),
        .sum_valid(sum_valid && sum_complete), .place(place), .sum(sum), .became(became),
        .has_best(has_best),
        .best(best), .best_sum(best_sum), .ties(ties),
        .has_second(has_second), .second(second), .second_sum(second_sum)
    );

    vpr_accept accept (
        .clk(clk), .best_sum(best_sum), .has_second(has_second), .second_sum(second_sum),
        .accepted(accepted)
    );

    // A window at a time: from its end until its match is taken, or there is none

    // the search's two clocks, and the first of the acceptance test; the trust takes six more
    localparam int FINISHING = FILTER ? 9 : 3;

    logic [FINISHING-1:0] finishing;

    wire finished = finishing[FINISHING-1];
    assign ends_search = finishing[1];

    wire match_taken = m_match_tvalid && m_match_tready;

    always_ff @(posedge clk) begin
        begun     <= window_end;
        compare   <= query_write && m_window_tlast;
        finishing <= FINISHING'({finishing, sum_valid && sum_last});
        if (finished) m_match_tvalid <= has_best;
        else if (match_taken) m_match_tvalid <= 1'b0;
        if (window_end) begin
            busy           <= 1'b1;
            window         <= window + 1'b1;
            m_window_tuser <= events_taken;
        end else if (match_taken || (finished && !has_best)) busy <= 1'b0;
        // no event is counted while the last window's counts are drained, or its number of events used
        pending      <= window_end || draining || !settled;
        window_ready <= !busy && !window_end && settled && filter_idle;
        if (rst) begin
            begun          <= 1'b0;
            pending        <= 1'b1;
            compare        <= 1'b0;
            finishing      <= '0;
            m_match_tvalid <= 1'b0;
            busy           <= 1'b0;
            window         <= '1;
        end
    end
endmodule
