// Replays a case of golden vectors in the folder where it runs, and writes records that
// `edge-vpr golden verify` reads. Both sides stall at random; resets come in the middle, after which
// the case begins again; whatever is undefined where it must not be, or changes before it is
// taken, ends the simulation. So does a core that takes nothing for far longer than a match lasts.
// With stalls, the places are offered again from the first word on behind each window's end, at any
// clock: while a match is computed they have to wait.
//
// With `reset_at` there is one reset, of one clock, so many clocks after the first; the places stay,
// and in that clock the bench is ready for all results, which no record has.
//
// +case=NAME +results=FILE +seed=N +stall=PER_CENT +resets=N +reset_at=N +trace=FILE.vcd
`timescale 1ns / 1ps
module vpr_bench #(
    parameter SLOW_BLOCKS = 0  // see vpr_core
);
    import vpr_pkg::*;

    logic                      clk = 1'b0;
    logic                      rst = 1'bx;
    logic [TIMESTAMP_BITS-1:0] start_time;
    logic [ACTIVITY_BITS-1:0]  start_activity;
    logic                      s_place_tvalid, s_place_tready;
    logic [WORD_BITS-1:0]      s_place_tdata;
    logic                      s_event_tvalid, s_event_tready;
    logic [EVENT_BITS-1:0]     s_event_tdata;
    logic                      m_event_tvalid, m_event_tready;
    logic [SEEN_BITS-1:0]      m_event_tdata;
    logic                      m_window_tvalid, m_window_tready, m_window_tlast;
    logic [WORD_BITS-1:0]      m_window_tdata;
    logic [31:0]               m_window_tuser;
    logic                      m_match_tvalid, m_match_tready;
    logic [MATCH_BITS-1:0]     m_match_tdata;

    // tables come from the files of the case
    vpr_core #(.SLOW_BLOCKS(SLOW_BLOCKS)) core (
        .clk_i(clk), .rst_i(rst), .load_i(7'd0), .load_address_i(20'd0), .load_word_i(32'd0),
        .start_time_i(start_time), .start_activity_i(start_activity), .*
    );

    always #10 clk = !clk;

    // Arguments

    string       case_name, results, trace;
    logic [63:0] start, activity;
    integer      seed, stall, resets, reset_at, start_file;
    initial begin
        if (!$value$plusargs("case=%s", case_name)) case_name = "case";
        if (!$value$plusargs("results=%s", results)) results = "results.csv";
        start_file = $fopen("start.mem", "r");
        if (start_file == 0) fail("start.mem cannot be opened");
        scanned = $fscanf(start_file, "%h", start);
        $fclose(start_file);
        activity = '0;
        if (PAUSES) begin
            start_file = $fopen("activity.mem", "r");
            if (start_file == 0) fail("activity.mem cannot be opened");
            scanned = $fscanf(start_file, "%h", activity);
            $fclose(start_file);
        end
        if (!$value$plusargs("seed=%d", seed)) seed = 1;
        if (!$value$plusargs("stall=%d", stall)) stall = 0;
        if (!$value$plusargs("resets=%d", resets)) resets = 0;
        if (!$value$plusargs("reset_at=%d", reset_at)) reset_at = 0;
        if (reset_at > 0) resets = 1;
        if ($value$plusargs("trace=%s", trace)) begin
            $dumpfile(trace);
            $dumpvars(1, vpr_bench);
        end
    end

    function automatic logic chance(input integer per_cent);
        chance = $unsigned($random(seed)) % 100 < per_cent;
    endfunction

    // Inputs: files are read word by word. A word that was offered stays until it is taken.

    integer events_file, places_file, scanned, out;
    integer events_given, idle_clocks, stuck_clocks, restart_at;
    logic   event_there, place_there, loaded, running;
    integer again;  // words of the places that were taken again since a window's end

    task automatic restart;
        begin
            running = 1'b0;
            if (events_file != 0) $fclose(events_file);
            if (places_file != 0) $fclose(places_file);
            if (out != 0) $fclose(out);
            events_file = $fopen("events.mem", "r");
            places_file = $fopen("places.mem", "r");
            out         = $fopen(results, "w");
            if (events_file == 0 || places_file == 0 || out == 0) fail("a file cannot be opened");
            $fwrite(out, "case,%0s\n", case_name);
            start_time = start[TIMESTAMP_BITS-1:0];
            start_activity = activity[ACTIVITY_BITS-1:0];
            s_event_tvalid = 1'b0;
            s_place_tvalid = 1'b0;
            m_event_tready = reset_at > 0;
            m_window_tready = reset_at > 0;
            m_match_tready = reset_at > 0;
            s_event_tdata = 'x;
            s_place_tdata = 'x;
            events_given = 0;
            idle_clocks = 0;
            stuck_clocks = 0;
            again = PLACES * WORDS;
            rst = 1'b1;
            if (reset_at > 0) @(negedge clk);
            else repeat (1 + $unsigned($random(seed)) % 3) @(negedge clk);
            rst = 1'b0;
            start_time = 'x;
            start_activity = 'x;
            running = 1'b1;
            next_event;
            // places stay, and need not come again
            if (loaded) loaded = reset_at > 0 || chance(50);
            if (loaded) place_there = 1'b0;
            else next_place;
        end
    endtask

    task automatic next_event;
        logic [EVENT_BITS-1:0] word;
        begin
            scanned = $fscanf(events_file, "%h", word);
            event_there = scanned == 1;
            s_event_tvalid = 1'b0;
            s_event_tdata = 'x;
            next_event_word = word;
        end
    endtask

    task automatic next_place;
        logic [WORD_BITS-1:0] word;
        begin
            scanned = $fscanf(places_file, "%h", word);
            place_there = scanned == 1;
            s_place_tvalid = 1'b0;
            s_place_tdata = 'x;
            next_place_word = word;
        end
    endtask

    logic [EVENT_BITS-1:0] next_event_word;
    logic [WORD_BITS-1:0]  next_place_word;
    logic [WORD_BITS-1:0]  places[0:PLACES*WORDS-1];
    initial $readmemh("places.mem", places);

    task automatic fail(input string what);
        begin
            $display("%0s: %0s, after %0d events", case_name, what, events_given);
            $fatal(1);
        end
    endtask

    // what was taken at the rising edge
    logic event_taken, place_taken, window_ended;
    always @(posedge clk) begin
        window_ended = core.window_end;
        event_taken = running && s_event_tvalid && s_event_tready;
        place_taken = running && s_place_tvalid && s_place_tready;
    end

    initial begin
        events_file = 0;
        places_file = 0;
        out = 0;
        restart_at = 0;
        running = 1'b0;
        loaded = 1'b0;
        repeat (2) @(negedge clk);
        restart;
        restart_at = reset_at > 0 ? reset_at : 20 + $unsigned($random(seed)) % 400;
        while (idle_clocks < MATCH_CLOCKS) begin
            @(negedge clk);
            if (event_taken) begin
                events_given = events_given + 1;
                next_event;
            end
            if (place_taken && loaded) begin
                s_place_tvalid = 1'b0;
                s_place_tdata  = 'x;
                again          = again + 1;
            end else if (place_taken) begin
                next_place;
                loaded = !place_there;
            end
            if (window_ended) again = 0;
            // the places first: a match with part of a map has no meaning
            if (event_there && !place_there && !s_event_tvalid && !chance(stall)) begin
                s_event_tvalid = 1'b1;
                s_event_tdata  = next_event_word;
            end
            if (place_there && !s_place_tvalid && !chance(stall)) begin
                s_place_tvalid = 1'b1;
                s_place_tdata  = next_place_word;
            end
            if (loaded && again < PLACES * WORDS && !s_place_tvalid && chance(stall)) begin
                s_place_tvalid = 1'b1;
                s_place_tdata  = places[again];
            end
            m_event_tready  = !chance(stall);
            m_window_tready = !chance(stall);
            m_match_tready  = !chance(stall);
            idle_clocks = event_there || place_there || m_match_tvalid || m_window_tvalid
                          ? 0 : idle_clocks + 1;
            stuck_clocks = event_taken || place_taken ? 0 : stuck_clocks + 1;
            if (stuck_clocks > 10 * MATCH_CLOCKS * 100 / (101 - stall))
                fail("neither takes an event nor comes to an end");
            restart_at = restart_at - 1;
            if (resets > 0 && restart_at <= 0) begin
                resets = resets - 1;
                restart_at = 1 + $unsigned($random(seed)) % 3000;
                restart;
            end
        end
        $fclose(out);
        $display("%0s: %0d events, at most %0d in a row, cycles a match %0d to %0d", case_name,
                 events_given, most_in_a_row, least_cycles, most_cycles);
        $finish;
    end

    // Outputs: records as they are taken, and the clocks from a window's end to its match

    string  line;  // events come between the words of a window
    integer events_seen, windows_seen, words_seen, lane;
    logic   match_before;
    wire    window_end = core.window_end;
    integer clock_now, ended_at, least_cycles, most_cycles, in_a_row, most_in_a_row;
    initial begin
        most_in_a_row = 0;
        clock_now    = 0;
        least_cycles = 0;
        most_cycles  = 0;
    end

    logic                  seen_selected;
    logic [SLOT_BITS-1:0]  seen_slot;
    logic [COUNT_BITS-1:0] seen_count;
    assign {seen_count, seen_slot, seen_selected} = m_event_tdata;

    logic                     accepted, has_second;
    logic [PLACE_BITS-1:0]    best, second, ties;
    logic [SUM_BITS-1:0]      best_sum, second_sum;
    logic [TRUST_BITS-1:0]    trust;
    logic [31:0]              window;
    // without a filter, the trust is beyond the word, and of no meaning
    assign {trust, accepted, ties, second_sum, second, has_second, best_sum, best, window} =
        (MATCH_BITS + TRUST_BITS)'(m_match_tdata);

    always @(posedge clk) begin
        clock_now = clock_now + 1;
        // events that were taken in successive clocks
        in_a_row = running && s_event_tvalid && s_event_tready ? in_a_row + 1 : 0;
        if (in_a_row > most_in_a_row) most_in_a_row = in_a_row;
        if (!running) begin
            events_seen  = 0;
            windows_seen = 0;
            words_seen   = 0;
            match_before = 1'b0;
        end else begin
            if (m_event_tvalid && m_event_tready) begin
                if (seen_selected)
                    $fwrite(out, "event,%0d,%0d,%0d\n", events_seen, seen_slot, seen_count);
                else $fwrite(out, "event,%0d,-1,%0d\n", events_seen, seen_count);
                events_seen = events_seen + 1;
            end
            if (window_end) ended_at = clock_now;
            if (m_window_tvalid && m_window_tready) begin
                if (words_seen == 0)
                    line = $sformatf("window,%0d,%0d", windows_seen, m_window_tuser);
                for (lane = 0; lane < LANES; lane = lane + 1)
                    if (words_seen * LANES + lane < SLOTS)
                        line = {line, $sformatf(",%0d", m_window_tdata[lane*CODE_BITS+:CODE_BITS])};
                    else if (m_window_tdata[lane*CODE_BITS+:CODE_BITS] !== 0)
                        fail("a lane beyond the last slot is not zero");
                words_seen = words_seen + 1;
                if (m_window_tlast !== (words_seen == WORDS)) fail("tlast is not with the last word");
                if (m_window_tlast) begin
                    $fwrite(out, "%0s\n", line);
                    words_seen   = 0;
                    windows_seen = windows_seen + 1;
                end
            end
            // of use without stalls
            if (m_match_tvalid && !match_before) begin
                if (least_cycles == 0 || clock_now - ended_at < least_cycles)
                    least_cycles = clock_now - ended_at;
                if (clock_now - ended_at > most_cycles) most_cycles = clock_now - ended_at;
            end
            match_before = m_match_tvalid;
            if (m_match_tvalid && m_match_tready) begin
                if (has_second)
                    $fwrite(out, "match,%0d,%0d,%0d,%0d,%0d,%0d,%0d", window, best, best_sum,
                            second, second_sum, ties, accepted);
                else if (second !== 0 || second_sum !== 0)
                    // equal to no record: the fields of a second best that there is not are 0
                    $fwrite(out, "match,%0d,-2,-2,-2,-2,-2,-2", window);
                else
                    $fwrite(out, "match,%0d,%0d,%0d,-1,-1,%0d,%0d", window, best, best_sum, ties,
                            accepted);
                if (FILTER) $fwrite(out, ",%0d\n", trust);
                else $fwrite(out, "\n");
            end
        end
    end

    // Rules of every stream: handshakes are never undefined, nor is what is offered, which stays
    // until it is taken

    logic                        held_event, held_window, held_match;
    logic [SEEN_BITS-1:0]        held_event_data;
    logic [WORD_BITS+32:0]       held_window_data;
    logic [MATCH_BITS-1:0]       held_match_data;
    wire  [WORD_BITS+32:0]       window_data = {m_window_tlast, m_window_tuser, m_window_tdata};
    always @(posedge clk) begin
        if (!running) begin
            held_event  = 1'b0;
            held_window = 1'b0;
            held_match  = 1'b0;
        end else begin
            if (^{s_event_tready, s_place_tready, m_event_tvalid, m_window_tvalid, m_match_tvalid}
                === 1'bx)
                fail("a handshake is undefined");
            if (m_event_tvalid && ^m_event_tdata === 1'bx) fail("m_event is undefined");
            if (m_window_tvalid && ^window_data === 1'bx) fail("m_window is undefined");
            if (m_match_tvalid && ^m_match_tdata === 1'bx) fail("m_match is undefined");
            if (held_event && (!m_event_tvalid || m_event_tdata !== held_event_data))
                fail("m_event changed before it was taken");
            if (held_window && (!m_window_tvalid || window_data !== held_window_data))
                fail("m_window changed before it was taken");
            if (held_match && (!m_match_tvalid || m_match_tdata !== held_match_data))
                fail("m_match changed before it was taken");
            held_event       = m_event_tvalid && !m_event_tready;
            held_window      = m_window_tvalid && !m_window_tready;
            held_match       = m_match_tvalid && !m_match_tready;
            held_event_data  = m_event_tdata;
            held_window_data = window_data;
            held_match_data  = m_match_tdata;
        end
    end
endmodule
