// Events to counters, one a clock: displacement, address, entry, slot, count, and the raised count
// are a clock each; the entry is two where block memories are slow (SLOW_BLOCKS).
//
// s_event carries a word of events.mem: time, column (16 bits), row (15), ON (1), from the least
// significant bit. m_event carries a word of expected_events.mem for each: selected, slot, count.
// An event that ends windows by time waits in the first stage until the matcher takes each of them
// (`window_ready_i`), and as many clocks longer as a timestamp has bits; those behind a window's last
// one by count wait before they are counted. So do all while the counters are drained (`pending_i`).
// `counted_o` follows each event that counts by a clock.
module vpr_events #(
    localparam bit BY_TIME         = vpr_pkg::BY_TIME,
    localparam int EVENT_TIME_BITS = vpr_pkg::EVENT_TIME_BITS,
    localparam int TIMESTAMP_BITS  = vpr_pkg::TIMESTAMP_BITS,
    localparam int EVENT_BITS      = vpr_pkg::EVENT_BITS,
    localparam int SEEN_BITS       = vpr_pkg::SEEN_BITS,
    localparam int SLOT_BITS       = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS      = vpr_pkg::COUNT_BITS,
    parameter  bit LOADABLE        = 0,
    parameter  bit SLOW_BLOCKS     = 0  // see vpr_core
) (
    input  logic                            clk_i,
    input  logic                            rst_i,
    input  logic [2:0]                      load_i,  // see vpr_rom
    input  logic [19:0]                     load_address_i,
    input  logic [31:0]                     load_word_i,
    input  logic [TIMESTAMP_BITS-1:0]       start_time_i,
    input  logic                            s_event_tvalid,
    output logic                            s_event_tready,
    input  logic [EVENT_BITS-1:0]           s_event_tdata,
    output logic                            m_event_tvalid,
    input  logic                            m_event_tready,
    output logic [SEEN_BITS-1:0]            m_event_tdata,
    input  logic                            pending_i,
    input  logic                            window_ready_i,
    output logic                            window_end_o,
    output logic [31:0]                     events_taken_o,
    output logic                            counted_o,
    input  logic                            draining_i,
    input  logic                            drain_i,
    input  logic [SLOT_BITS-1:0]            drain_slot_i,
    output logic [COUNT_BITS-1:0]           drained_o,
    output logic [SLOT_BITS-1:0]            drained_slot_o
);
    localparam int ENTRY_STEPS = SLOW_BLOCKS ? 2 : 1;

    // an event in each stage: its displacement, address, entry, slot, count, and raised count
    logic displaces_q, addresses_q, has_slot_q, has_count_q, has_raised_q;
    logic [ENTRY_STEPS-1:0] enters_q;

    logic                  settled, over, full;
    logic                  counts;  // the event with the raised count is of a selected pixel
    logic                  in_limit;  // and within the limit of this pixel
    logic                  selected;
    logic [SLOT_BITS-1:0]  slot, raised_slot;
    logic [COUNT_BITS-1:0] raised;

    wire moves = !has_raised_q || m_event_tready;       // the last two stages
    wire looks = moves && !full && !pending_i;          // those before them
    wire waits = displaces_q && (over || !settled);     // in the first stage, for its window

    wire room = !displaces_q || (looks && !over);        // but while a window's end moves

    assign s_event_tready = settled && room;
    assign m_event_tvalid = has_raised_q;
    assign m_event_tdata  = counts ? {raised, raised_slot, 1'b1} : '0;

    // all events of the window are counted
    // verilator lint_off WIDTH
    wire ends = BY_TIME ? displaces_q && over && settled && !addresses_q && !enters_q && !has_slot_q : full;
    // verilator lint_on WIDTH

    always_ff @(posedge clk_i) begin
        window_end_o <= window_ready_i && ends && !has_count_q && !has_raised_q && !counted_o
            && !window_end_o;
        counted_o    <= counts && in_limit && moves;
        // one that leaves makes room in the same clock
        displaces_q  <= (s_event_tready && s_event_tvalid) || (!s_event_tready && displaces_q);
        if (looks) begin
            addresses_q <= displaces_q && !waits;
            enters_q    <= ENTRY_STEPS'({enters_q, addresses_q});
            has_slot_q  <= enters_q[ENTRY_STEPS-1];
        end
        if (moves) begin
            has_count_q  <= has_slot_q && looks;
            has_raised_q <= has_count_q;
        end
        if (m_event_tvalid && m_event_tready) events_taken_o <= events_taken_o + 1'b1;
        if (rst_i) begin
            window_end_o   <= 1'b0;
            counted_o      <= 1'b0;
            displaces_q    <= 1'b0;
            addresses_q    <= 1'b0;
            enters_q       <= '0;
            has_slot_q     <= 1'b0;
            has_count_q    <= 1'b0;
            has_raised_q   <= 1'b0;
            events_taken_o <= '0;
        end
    end

    // nobody looks at the polarity; windows by count do not look at the time, nor narrow clocks at all of it
    wire unused = &{1'b0, s_event_tdata, start_time_i};

    vpr_pixel_lookup #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) pixel_lookup (
        .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[1:0]), .load_address_i(load_address_i),
        .load_word_i(load_word_i),
        .take_i(s_event_tready), .enable_i(looks),
        .column_i(s_event_tdata[EVENT_TIME_BITS+:16]),
        .row_i(s_event_tdata[EVENT_TIME_BITS+16+:15]),
        .selected_o(selected), .slot_o(slot)
    );

    wire counting = has_slot_q && selected && looks;

    generate
        if (BY_TIME) begin : g_by_time
            assign full = 1'b0;
            vpr_window_timer window_timer (
                .clk_i(clk_i), .load_i(rst_i), .start_time_i(start_time_i),
                .next_window_i(window_end_o),
                .take_i(room), .timestamp_i(s_event_tdata[TIMESTAMP_BITS-1:0]),
                .settled_o(settled), .over_o(over)
            );
        end else begin : g_by_count
            assign settled = 1'b1;
            assign over    = 1'b0;
            vpr_window_quota window_quota (
                .clk_i(clk_i), .load_i(rst_i), .counted_i(counting), .next_window_i(window_end_o),
                .full_o(full)
            );
        end
    endgenerate

    vpr_counters #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) counters (
        .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i[2]), .load_address_i(load_address_i),
        .load_word_i(load_word_i), .enable_i(moves), .take_i(counting), .slot_i(slot),
        .raises_o(counts), .in_limit_o(in_limit), .raised_slot_o(raised_slot), .raised_o(raised),
        .draining_i(draining_i), .drain_i(drain_i), .drain_slot_i(drain_slot_i), .drained_o(drained_o),
        .read_slot_o(drained_slot_o)
    );
endmodule
