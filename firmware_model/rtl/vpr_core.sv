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
    parameter int          HEIGHT            = 2,
    parameter int          PIXELS            = 1,
    parameter bit          POLARITY          = 0,
    parameter int          LOOKUP_DEPTH      = 2,
    parameter int          SLOTS             = 1,
    parameter int          TABLES            = 1,
    parameter int          COUNT_MAX         = 1,
    parameter bit          BY_TIME           = 1,
    parameter logic [63:0] TAU_US            = 1,
    parameter logic [31:0] WINDOW_EVENTS     = 1,
    parameter int          PLACES            = 1,
    parameter int          WORDS             = 1,
    parameter int          LANES             = 1,
    parameter int          LENGTH            = 1,
    parameter bit          OWN_MEAN          = 0,
    parameter bit          CONTRAST          = 0,
    parameter bit          FILTER            = 0,
    parameter bit          KEEP_DISTANCES    = 0,
    parameter int          STEPS             = 1,
    parameter int          BACK              = 0,
    parameter bit          ACTIVITY_COSTS    = 0,
    parameter logic [159:0] STEP_PRICES      = 0,
    parameter logic [159:0] BACK_PRICES      = 0,
    parameter logic [9:0]  RESTART           = 0,
    parameter logic [8:0]  TRUST             = 0,
    parameter int          EXCLUSION         = 0,
    parameter bit          BY_MARGIN         = 0,
    parameter logic [31:0] MARGIN            = 0,
    parameter logic [15:0] NUMERATOR         = 1,
    parameter logic [15:0] DENOMINATOR       = 2,
    parameter int          EVENT_TIME_BITS   = 32,
    parameter int          TIMESTAMP_BITS    = 32,
    parameter int          COLUMN_BITS       = 1,
    parameter int          ROW_BITS          = 1,
    parameter int          ADDRESS_BITS      = 1,
    parameter int          OWNER_BITS        = 2,
    parameter int          SLOT_BITS         = 1,
    parameter int          COUNT_BITS        = 1,
    parameter int          WINDOW_COUNT_BITS = 1,
    parameter int          TABLE_BITS        = 1,
    parameter int          ENTRY_BITS        = 1,
    parameter int          CODE_BITS         = 1,
    parameter int          DISTANCE_BITS     = 1,
    parameter int          SUM_BITS          = 1,
    parameter int          PRODUCT_BITS      = 2,
    parameter int          PLACE_BITS        = 1,
    parameter int          WINDOW_EVENTS_BITS  = 23,
    parameter int          ACTIVITY_BITS       = 31,
    parameter int          MEAN_BITS           = 17,
    parameter int          DISTANCE_TOTAL_BITS = 1,
    parameter int          RECIPROCAL_BITS     = 17,
    parameter int          EVIDENCE_BITS       = 8,
    parameter int          TRUST_BITS          = 9,
    parameter int          MATCH_BITS          = 39,
    parameter              MEMORY_STYLE      = "auto",
    parameter              PLACES_FILE       = "",
    parameter              LOADABLE          = 0,
    parameter              SLOW_BLOCKS       = 0
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
    input  logic [LANES*CODE_BITS-1:0]             s_place_tdata,

    input  logic                                   s_event_tvalid,
    output logic                                   s_event_tready,
    input  logic [EVENT_TIME_BITS+31:0]            s_event_tdata,

    output logic                                   m_event_tvalid,
    input  logic                                   m_event_tready,
    output logic [SLOT_BITS+COUNT_BITS:0]          m_event_tdata,

    output logic                                   m_window_tvalid,
    input  logic                                   m_window_tready,
    output logic [LANES*CODE_BITS-1:0]             m_window_tdata,
    output logic                                   m_window_tlast,
    output logic [31:0]                            m_window_tuser,

    output logic                                   m_match_tvalid,
    input  logic                                   m_match_tready,
    output logic [MATCH_BITS-1:0]                  m_match_tdata
);
    localparam int PLACE_ADDRESS_BITS = PLACES * WORDS > 1 ? $clog2(PLACES * WORDS) : 1;
    localparam int LONGER             = WORDS > LENGTH ? WORDS : LENGTH;
    // clocks a place: words of a distance, terms of a sum, and two of the search
    localparam int PERIOD             = LONGER > 2 ? LONGER : 2;

    // Events, and the descriptor of a window that ended

    logic                       busy;
    logic                       window_ready, window_end;
    logic [31:0]                events_taken;
    logic                       counted, paused, settled, pending;
    logic                       drain, draining;
    logic [SLOT_BITS-1:0]       drain_slot, drained_slot;
    logic [COUNT_BITS-1:0]      drained;
    logic [LANES*CODE_BITS-1:0] place_word;
    logic [9:0]                 activity_inverse;

    vpr_events #(
        .HEIGHT(HEIGHT), .PIXELS(PIXELS), .POLARITY(POLARITY),
        .LOOKUP_DEPTH(LOOKUP_DEPTH), .SLOTS(SLOTS), .COUNT_MAX(COUNT_MAX), .BY_TIME(BY_TIME),
        .TAU_US(TAU_US), .WINDOW_EVENTS(WINDOW_EVENTS), .EVENT_TIME_BITS(EVENT_TIME_BITS),
        .TIMESTAMP_BITS(TIMESTAMP_BITS), .COLUMN_BITS(COLUMN_BITS), .ROW_BITS(ROW_BITS),
        .ADDRESS_BITS(ADDRESS_BITS), .OWNER_BITS(OWNER_BITS), .SLOT_BITS(SLOT_BITS),
        .COUNT_BITS(COUNT_BITS), .WINDOW_COUNT_BITS(WINDOW_COUNT_BITS),
        .LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)
    ) events (
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

    vpr_encoder #(
        .SLOTS(SLOTS), .WORDS(WORDS), .LANES(LANES), .TABLES(TABLES), .COUNT_MAX(COUNT_MAX),
        .OWN_MEAN(OWN_MEAN), .CONTRAST(CONTRAST), .SLOT_BITS(SLOT_BITS), .COUNT_BITS(COUNT_BITS),
        .TABLE_BITS(TABLE_BITS), .ENTRY_BITS(ENTRY_BITS), .MEAN_BITS(MEAN_BITS),
        .CODE_BITS(CODE_BITS), .LOADABLE(LOADABLE)
    ) encoder (
        .clk(clk), .rst(rst), .load(load[4:2]), .load_address(load_address), .load_word(load_word),
        .start(window_end), .paused(paused),
        .draining(draining), .drain(drain), .drain_slot(drain_slot), .drained(drained),
        .drained_slot(drained_slot),
        .word_valid(m_window_tvalid), .word_ready(m_window_tready),
        .word_last(m_window_tlast), .word(m_window_tdata)
    );

    generate
        if (OWN_MEAN || FILTER) begin : g_pauses
            logic pauses;
            vpr_activity #(
                .EVENTS_BITS(WINDOW_EVENTS_BITS), .ACTIVITY_BITS(ACTIVITY_BITS),
                .LOGARITHMS(FILTER)
            ) activity (
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

    vpr_place_memory #(
        .PLACES(PLACES), .WORDS(WORDS), .WORD_BITS(LANES * CODE_BITS),
        .ADDRESS_BITS(PLACE_ADDRESS_BITS), .MEMORY_STYLE(MEMORY_STYLE),
        .FILE(PLACES_FILE)
    ) place_memory (
        .clk(clk), .rst(rst), .busy(busy), .stop(window_end),
        .s_place_tvalid(s_place_tvalid), .s_place_tready(s_place_tready),
        .s_place_tdata(s_place_tdata),
        .start(begun), .step(place_step), .last(place_last), .word(place_word)
    );

    vpr_distance #(
        .WORDS(WORDS), .LANES(LANES), .PERIOD(PERIOD), .CODE_BITS(CODE_BITS),
        .DISTANCE_BITS(DISTANCE_BITS), .SLOW_BLOCKS(SLOW_BLOCKS)
    ) distances (
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

            vpr_filter #(
                .PLACES(PLACES), .KEEP(KEEP_DISTANCES), .STEPS(STEPS), .BACK(BACK),
                .ACTIVITY_COSTS(ACTIVITY_COSTS), .STEP_PRICES(STEP_PRICES), .BACK_PRICES(BACK_PRICES), .RESTART(RESTART),
                .PLACE_BITS(PLACE_BITS), .DISTANCE_BITS(DISTANCE_BITS),
                .TOTAL_BITS(DISTANCE_TOTAL_BITS), .RECIPROCAL_BITS(RECIPROCAL_BITS),
                .EVIDENCE_BITS(EVIDENCE_BITS), .METRIC_BITS(SUM_BITS), .LOADABLE(LOADABLE)
            ) place_filter (
                .clk(clk), .rst(rst), .load(load[5]), .load_address(load_address),
                .load_word(load_word), .start(compare), .paused(paused), .settled(settled),
                .activity_inverse(activity_inverse), .idle(filter_idle),
                .distance_start(distance_start), .distance_valid(distance_valid),
                .distance(distance), .sum_valid(sum_valid), .sum_last(sum_last), .place(place),
                .sum(sum), .misfit(misfit), .found(ends_search), .best_sum(best_sum)
            );
            assign sum_complete = 1'b1;
            vpr_trust #(
                .STEPS(STEPS), .BACK(BACK), .TRUST(TRUST), .PLACE_BITS(PLACE_BITS),
                .METRIC_BITS(SUM_BITS), .TRUST_BITS(TRUST_BITS)
            ) trust_in_matches (
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
            vpr_sequence #(
                .PLACES(PLACES), .LENGTH(LENGTH), .PLACE_BITS(PLACE_BITS),
                .DISTANCE_BITS(DISTANCE_BITS), .SUM_BITS(SUM_BITS), .MEMORY_STYLE(MEMORY_STYLE),
                .SLOW_BLOCKS(SLOW_BLOCKS)
            ) sequence_sums (
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

    vpr_search #(
        .EXCLUSION(EXCLUSION), .SUM_BITS(SUM_BITS), .PLACE_BITS(PLACE_BITS),
        .SLOW_BLOCKS(SLOW_BLOCKS)
    ) search (
        .clk(clk), .rst(rst), .start(compare),
        .sum_valid(sum_valid && sum_complete), .place(place), .sum(sum), .became(became),
        .has_best(has_best),
        .best(best), .best_sum(best_sum), .ties(ties),
        .has_second(has_second), .second(second), .second_sum(second_sum)
    );

    vpr_accept #(
        .BY_MARGIN(BY_MARGIN), .MARGIN(MARGIN), .NUMERATOR(NUMERATOR), .DENOMINATOR(DENOMINATOR),
        .SUM_BITS(SUM_BITS), .PRODUCT_BITS(PRODUCT_BITS)
    ) accept (
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
