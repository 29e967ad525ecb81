// Events to counters, one a clock: displacement, address, entry, slot, count, and the raised count
// are a clock each; the entry is two where block memories are slow (SLOW_BLOCKS).
//
// s_event carries a word of events.mem: time, column (16 bits), row (15), ON (1), from the least
// significant bit. m_event carries a word of expected_events.mem for each: selected, slot, count.
// An event that ends windows by time waits in the first stage until the matcher takes each of them
// (`window_ready`), and as many clocks longer as a timestamp has bits; those behind a window's last
// one by count wait before they are counted. So do all while the counters are drained (`pending`).
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
    input  logic                            clk,
    input  logic                            rst,
    input  logic [1:0]                      load,  // see vpr_rom
    input  logic [19:0]                     load_address,
    input  logic [31:0]                     load_word,
    input  logic [TIMESTAMP_BITS-1:0]       start_time,
    input  logic                            s_event_tvalid,
    output logic                            s_event_tready,
    input  logic [EVENT_BITS-1:0]           s_event_tdata,
    output logic                            m_event_tvalid,
    input  logic                            m_event_tready,
    output logic [SEEN_BITS-1:0]            m_event_tdata,
    input  logic                            pending,
    input  logic                            window_ready,
    output logic                            window_end,
    output logic [31:0]                     events_taken,
    output logic                            counted,
    input  logic                            draining,
    input  logic                            drain,
    input  logic [SLOT_BITS-1:0]            drain_slot,
    output logic [COUNT_BITS-1:0]           drained,
    output logic [SLOT_BITS-1:0]            drained_slot
);
    localparam int ENTRY_STEPS = SLOW_BLOCKS ? 2 : 1;

    // an event in each stage: its displacement, address, entry, slot, count, and raised count
    logic displaces, addresses, has_slot, has_count, has_raised;
    logic [ENTRY_STEPS-1:0] enters;

    logic                  settled, over, full;
    logic                  counts;  // the event with the raised count is of a selected pixel
    logic                  selected;
    logic [SLOT_BITS-1:0]  slot, raised_slot;
    logic [COUNT_BITS-1:0] raised;

    wire moves = !has_raised || m_event_tready;       // the last two stages
    wire looks = moves && !full && !pending;          // those before them
    wire waits = displaces && (over || !settled);     // in the first stage, for its window
    wire take  = s_event_tvalid && s_event_tready;

    wire room = !displaces || (looks && !over);        // but while a window's end moves

    assign s_event_tready = settled && room;
    assign m_event_tvalid = has_raised;
    assign m_event_tdata  = counts ? {raised, raised_slot, 1'b1} : '0;

    assign counted = counts && moves;

    // all events of the window are counted
    // verilator lint_off WIDTH
    wire ends = BY_TIME ? displaces && over && settled && !addresses && !enters && !has_slot : full;
    // verilator lint_on WIDTH

    always_ff @(posedge clk) begin
        window_end <= window_ready && ends && !has_count && !has_raised && !window_end;
        // one that leaves makes room in the same clock
        displaces  <= s_event_tready ? s_event_tvalid : displaces;
        if (looks) begin
            addresses <= displaces && !waits;
            enters    <= ENTRY_STEPS'({enters, addresses});
            has_slot  <= enters[ENTRY_STEPS-1];
        end
        if (moves) begin
            has_count  <= has_slot && looks;
            has_raised <= has_count;
        end
        if (m_event_tvalid && m_event_tready) events_taken <= events_taken + 1'b1;
        if (rst) begin
            window_end   <= 1'b0;
            displaces    <= 1'b0;
            addresses    <= 1'b0;
            enters       <= '0;
            has_slot     <= 1'b0;
            has_count    <= 1'b0;
            has_raised   <= 1'b0;
            events_taken <= '0;
        end
    end

    // windows by count do not look at the time, nor narrow clocks at all of it
    wire unused = &{1'b0, s_event_tdata, start_time};

    vpr_pixel_lookup #(.LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)) pixel_lookup (
        .clk(clk), .rst(rst), .load(load), .load_address(load_address), .load_word(load_word),
        .take(take), .enable(looks),
        .column(s_event_tdata[EVENT_TIME_BITS+:16]),
        .row(s_event_tdata[EVENT_TIME_BITS+16+:15]),
        .on(s_event_tdata[EVENT_TIME_BITS+31]),
        .selected(selected), .slot(slot)
    );

    wire counting = has_slot && selected && looks;

    generate
        if (BY_TIME) begin : g_by_time
            assign full = 1'b0;
            vpr_window_timer window_timer (
                .clk(clk), .load(rst), .start_time(start_time), .next_window(window_end),
                .take(room), .timestamp(s_event_tdata[TIMESTAMP_BITS-1:0]),
                .settled(settled), .over(over)
            );
        end else begin : g_by_count
            assign settled = 1'b1;
            assign over    = 1'b0;
            vpr_window_quota window_quota (
                .clk(clk), .load(rst), .counted(counting), .next_window(window_end), .full(full)
            );
        end
    endgenerate

    vpr_counters #(.SLOW_BLOCKS(SLOW_BLOCKS)) counters (
        .clk(clk), .rst(rst), .enable(moves), .take(counting), .slot(slot),
        .raises(counts), .raised_slot(raised_slot), .raised(raised),
        .draining(draining), .drain(drain), .drain_slot(drain_slot), .drained(drained),
        .read_slot(drained_slot)
    );
endmodule
