// Events to counters: four clocks an event, and a further four for each window that it ends.
//
// s_event carries a word of events.mem: time, column (16 bits), row (15), ON (1), from the least
// significant bit. m_event carries a word of expected_events.mem for each: selected, slot, count.
// An event that ends windows by time waits until the matcher takes each of them (`window_ready`);
// so does the event behind a window's last one by count.
module vpr_events #(
    parameter int          HEIGHT            = 2,
    parameter int          PIXELS            = 1,
    parameter bit          POLARITY          = 0,
    parameter int          LOOKUP_DEPTH      = 2,
    parameter int          SLOTS             = 1,
    parameter int          COUNT_MAX         = 1,
    parameter bit          BY_TIME           = 1,
    parameter logic [63:0] TAU_US            = 1,
    parameter logic [31:0] WINDOW_EVENTS     = 1,
    parameter int          EVENT_TIME_BITS   = 32,
    parameter int          TIMESTAMP_BITS    = 32,
    parameter int          COLUMN_BITS       = 1,
    parameter int          ROW_BITS          = 1,
    parameter int          ADDRESS_BITS      = 1,
    parameter int          OWNER_BITS        = 2,
    parameter int          SLOT_BITS         = 1,
    parameter int          COUNT_BITS        = 1,
    parameter int          WINDOW_COUNT_BITS = 1,
    parameter bit          LOADABLE          = 0
) (
    input  logic                            clk,
    input  logic                            rst,
    input  logic [1:0]                      load,  // see vpr_rom
    input  logic [19:0]                     load_address,
    input  logic [31:0]                     load_word,
    input  logic [TIMESTAMP_BITS-1:0]       start_time,
    input  logic                            s_event_tvalid,
    output logic                            s_event_tready,
    input  logic [EVENT_TIME_BITS+31:0]     s_event_tdata,
    output logic                            m_event_tvalid,
    input  logic                            m_event_tready,
    output logic [SLOT_BITS+COUNT_BITS:0]   m_event_tdata,
    input  logic                            clearing,
    input  logic                            window_ready,
    output logic                            window_end,
    output logic [31:0]                     events_taken,
    output logic                            counted,
    input  logic                            drain,
    input  logic [SLOT_BITS-1:0]            drain_slot,
    output logic [COUNT_BITS-1:0]           drained,
    input  logic                            clear,
    input  logic [SLOT_BITS-1:0]            clear_slot
);
    localparam logic [2:0] CLEARING = 3'd0;
    localparam logic [2:0] IDLE     = 3'd1;
    localparam logic [2:0] ADDRESS  = 3'd2;  // the row's displacement is there
    localparam logic [2:0] ENTRY    = 3'd3;  // the look-up's entry is there
    localparam logic [2:0] COUNT    = 3'd4;  // slot, and whether the window has ended
    localparam logic [2:0] DONE     = 3'd5;  // the slot's count
    localparam logic [2:0] FULL     = 3'd6;  // the window by count has ended

    logic [2:0]                state;
    logic [TIMESTAMP_BITS-1:0] timestamp;
    logic                      selected;
    logic [SLOT_BITS-1:0]      slot;
    logic [COUNT_BITS-1:0]     raised;
    logic                      time_over;
    logic                      last_counted;

    wire take      = s_event_tvalid && s_event_tready;
    wire finish    = state == DONE && m_event_tready;
    wire full_next = !BY_TIME && selected && last_counted;

    assign s_event_tready = state == IDLE || (finish && !full_next);
    assign m_event_tvalid = state == DONE;
    assign m_event_tdata  = selected ? {raised, slot, 1'b1} : '0;
    assign counted        = finish && selected;
    assign window_end     = window_ready && ((state == COUNT && time_over) || state == FULL);

    always_ff @(posedge clk) begin
        if (take) timestamp <= s_event_tdata[TIMESTAMP_BITS-1:0];
        case (state)
            CLEARING: if (!clearing) state <= IDLE;
            ADDRESS:  state <= ENTRY;
            ENTRY:    state <= COUNT;
            COUNT: begin
                if (!time_over) state <= DONE;
                else if (window_ready) state <= ADDRESS;
            end
            DONE:     if (finish) state <= full_next ? FULL : take ? ADDRESS : IDLE;
            FULL:     if (window_ready) state <= IDLE;
            default:  if (take) state <= ADDRESS;
        endcase
        if (finish) events_taken <= events_taken + 1'b1;
        if (rst) begin
            state        <= CLEARING;
            events_taken <= '0;
        end
    end

    // windows by count do not look at the time, nor narrow clocks at all of it
    wire unused = &{1'b0, s_event_tdata, start_time, timestamp};

    vpr_pixel_lookup #(
        .HEIGHT(HEIGHT), .PIXELS(PIXELS), .POLARITY(POLARITY),
        .DEPTH(LOOKUP_DEPTH), .COLUMN_BITS(COLUMN_BITS), .ROW_BITS(ROW_BITS),
        .ADDRESS_BITS(ADDRESS_BITS), .OWNER_BITS(OWNER_BITS), .SLOT_BITS(SLOT_BITS),
        .LOADABLE(LOADABLE)
    ) pixel_lookup (
        .clk(clk), .load(load), .load_address(load_address), .load_word(load_word),
        .take(take),
        .column(s_event_tdata[EVENT_TIME_BITS+:16]),
        .row(s_event_tdata[EVENT_TIME_BITS+16+:15]),
        .on(s_event_tdata[EVENT_TIME_BITS+31]),
        .selected(selected), .slot(slot)
    );

    generate
        if (BY_TIME) begin : g_by_time
            assign last_counted = 1'b0;
            vpr_window_timer #(
                .TIMESTAMP_BITS(TIMESTAMP_BITS), .TAU_US(TAU_US)
            ) window_timer (
                .clk(clk), .load(rst), .start_time(start_time), .next_window(window_end),
                .timestamp(timestamp), .ended(time_over)
            );
        end else begin : g_by_count
            assign time_over = 1'b0;
            vpr_window_quota #(
                .WINDOW_COUNT_BITS(WINDOW_COUNT_BITS), .WINDOW_EVENTS(WINDOW_EVENTS)
            ) window_quota (
                .clk(clk), .load(rst), .counted(counted), .last(last_counted)
            );
        end
    endgenerate

    vpr_counters #(
        .SLOTS(SLOTS), .SLOT_BITS(SLOT_BITS), .COUNT_BITS(COUNT_BITS), .COUNT_MAX(COUNT_MAX)
    ) counters (
        .clk(clk), .rst(rst), .clearing(clearing), .swap(window_end),
        .slot(slot), .raise(counted), .raised(raised),
        .drain(drain), .drain_slot(drain_slot), .drained(drained),
        .clear(clear), .clear_slot(clear_slot)
    );
endmodule
