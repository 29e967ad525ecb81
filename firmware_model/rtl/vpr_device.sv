// The place recogniser of one design: vpr_core with the parameters of the generated package.
module vpr_device #(
    parameter MEMORY_STYLE = "auto",  // of the places and of past distances, see vpr_ram_single
    parameter PLACES_FILE  = "",      // of the places; they may be loaded instead
    parameter LOADABLE     = 0,       // tables are loaded, in place of their files
    // where block memories take more than half a clock: counts and delay lines are not kept in them,
    // and entries of the look-up, the descriptor and places, and past distances have a register
    // behind them: an event takes a clock more, and a match one for each pass over places, and one more
    // with sequences of two and more
    parameter SLOW_BLOCKS  = 0
) (
    input  logic clk,
    input  logic rst,
    input  logic [5:0]  load,
    input  logic [19:0] load_address,
    input  logic [31:0] load_word,
    input  logic [vpr_design::TIMESTAMP_BITS-1:0] start_time,
    input  logic [vpr_design::ACTIVITY_BITS-1:0]  start_activity,

    input  logic s_place_tvalid,
    output logic s_place_tready,
    input  logic [vpr_design::LANES*vpr_design::CODE_BITS-1:0] s_place_tdata,

    input  logic s_event_tvalid,
    output logic s_event_tready,
    input  logic [vpr_design::EVENT_TIME_BITS+31:0] s_event_tdata,

    output logic m_event_tvalid,
    input  logic m_event_tready,
    output logic [vpr_design::SLOT_BITS+vpr_design::COUNT_BITS:0] m_event_tdata,

    output logic m_window_tvalid,
    input  logic m_window_tready,
    output logic [vpr_design::LANES*vpr_design::CODE_BITS-1:0] m_window_tdata,
    output logic m_window_tlast,
    output logic [31:0] m_window_tuser,

    output logic m_match_tvalid,
    input  logic m_match_tready,
    output logic [vpr_design::MATCH_BITS-1:0] m_match_tdata
);
    vpr_core #(
        .HEIGHT(vpr_design::HEIGHT), .PIXELS(vpr_design::PIXELS), .POLARITY(vpr_design::POLARITY),
        .LOOKUP_DEPTH(vpr_design::LOOKUP_DEPTH), .SLOTS(vpr_design::SLOTS),
        .TABLES(vpr_design::TABLES), .COUNT_MAX(vpr_design::COUNT_MAX),
        .BY_TIME(vpr_design::BY_TIME), .TAU_US(vpr_design::TAU_US),
        .WINDOW_EVENTS(vpr_design::WINDOW_EVENTS), .PLACES(vpr_design::PLACES),
        .WORDS(vpr_design::WORDS), .LANES(vpr_design::LANES), .LENGTH(vpr_design::LENGTH),
        .OWN_MEAN(vpr_design::OWN_MEAN), .CONTRAST(vpr_design::CONTRAST),
        .FILTER(vpr_design::FILTER),
        .KEEP_DISTANCES(vpr_design::KEEP_DISTANCES), .STEPS(vpr_design::STEPS),
        .BACK(vpr_design::BACK), .ACTIVITY_COSTS(vpr_design::ACTIVITY_COSTS),
        .STEP_PRICES(vpr_design::STEP_PRICES),
        .BACK_PRICES(vpr_design::BACK_PRICES), .RESTART(vpr_design::RESTART),
        .TRUST(vpr_design::TRUST), .EXCLUSION(vpr_design::EXCLUSION),
        .BY_MARGIN(vpr_design::BY_MARGIN), .MARGIN(vpr_design::MARGIN),
        .NUMERATOR(vpr_design::NUMERATOR), .DENOMINATOR(vpr_design::DENOMINATOR),
        .EVENT_TIME_BITS(vpr_design::EVENT_TIME_BITS), .TIMESTAMP_BITS(vpr_design::TIMESTAMP_BITS),
        .COLUMN_BITS(vpr_design::COLUMN_BITS), .ROW_BITS(vpr_design::ROW_BITS),
        .ADDRESS_BITS(vpr_design::ADDRESS_BITS), .OWNER_BITS(vpr_design::OWNER_BITS),
        .SLOT_BITS(vpr_design::SLOT_BITS), .COUNT_BITS(vpr_design::COUNT_BITS),
        .WINDOW_COUNT_BITS(vpr_design::WINDOW_COUNT_BITS), .TABLE_BITS(vpr_design::TABLE_BITS),
        .ENTRY_BITS(vpr_design::ENTRY_BITS), .CODE_BITS(vpr_design::CODE_BITS),
        .DISTANCE_BITS(vpr_design::DISTANCE_BITS), .SUM_BITS(vpr_design::SUM_BITS),
        .PRODUCT_BITS(vpr_design::PRODUCT_BITS), .PLACE_BITS(vpr_design::PLACE_BITS),
        .WINDOW_EVENTS_BITS(vpr_design::WINDOW_EVENTS_BITS),
        .ACTIVITY_BITS(vpr_design::ACTIVITY_BITS), .MEAN_BITS(vpr_design::MEAN_BITS),
        .DISTANCE_TOTAL_BITS(vpr_design::DISTANCE_TOTAL_BITS),
        .RECIPROCAL_BITS(vpr_design::RECIPROCAL_BITS), .EVIDENCE_BITS(vpr_design::EVIDENCE_BITS),
        .TRUST_BITS(vpr_design::TRUST_BITS), .MATCH_BITS(vpr_design::MATCH_BITS),
        .MEMORY_STYLE(MEMORY_STYLE), .PLACES_FILE(PLACES_FILE), .LOADABLE(LOADABLE), .SLOW_BLOCKS(SLOW_BLOCKS)
    ) core (
        .clk(clk), .rst(rst), .load(load), .load_address(load_address), .load_word(load_word),
        .start_time(start_time), .start_activity(start_activity),
        .s_place_tvalid(s_place_tvalid),
        .s_place_tready(s_place_tready), .s_place_tdata(s_place_tdata),
        .s_event_tvalid(s_event_tvalid), .s_event_tready(s_event_tready),
        .s_event_tdata(s_event_tdata), .m_event_tvalid(m_event_tvalid),
        .m_event_tready(m_event_tready), .m_event_tdata(m_event_tdata),
        .m_window_tvalid(m_window_tvalid), .m_window_tready(m_window_tready),
        .m_window_tdata(m_window_tdata), .m_window_tlast(m_window_tlast),
        .m_window_tuser(m_window_tuser), .m_match_tvalid(m_match_tvalid),
        .m_match_tready(m_match_tready), .m_match_tdata(m_match_tdata)
    );
endmodule
