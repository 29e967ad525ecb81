// vpr_core gets on, for any inputs, tables and places: properties for the bounded model checker. The
// core's memories are replaced by vpr_free_memories, and its activity by
// vpr_free_activity.
module vpr_core_properties #(
    localparam FILTER      = vpr_pkg::FILTER,
    localparam EVENT_BITS  = vpr_pkg::EVENT_BITS,
    localparam SEEN_BITS   = vpr_pkg::SEEN_BITS,
    localparam WORD_BITS   = vpr_pkg::WORD_BITS,
    localparam MATCH_BITS  = vpr_pkg::MATCH_BITS,
    parameter  PROGRESS    = 40
) (
    input logic                  clk,
    input logic                  rst,
    input logic [3:0]            start_time,
    input logic                  s_place_tvalid,
    input logic                  s_event_tvalid,
    input logic [EVENT_BITS-1:0] s_event_tdata,
    input logic                  m_event_tready,
    input logic                  m_window_tready,
    input logic                  m_match_tready
);
    logic                  s_place_tready, s_event_tready;
    logic                  m_event_tvalid, m_window_tvalid, m_window_tlast, m_match_tvalid;
    logic [SEEN_BITS-1:0]  m_event_tdata;
    logic [WORD_BITS-1:0]  m_window_tdata;
    logic [31:0]           m_window_tuser;
    logic [MATCH_BITS-1:0] m_match_tdata;

    (* anyseq *) logic [WORD_BITS-1:0] s_place_tdata;

    vpr_core core (
        .clk_i(clk), .rst_i(rst), .load_i(5'd0), .load_address_i(20'd0), .load_word_i(32'd0),
        .start_time_i(start_time), .start_activity_i(10'd0),
        .s_place_tvalid(s_place_tvalid), .s_place_tready(s_place_tready),
        .s_place_tdata(s_place_tdata),
        .s_event_tvalid(s_event_tvalid), .s_event_tready(s_event_tready),
        .s_event_tdata(s_event_tdata),
        .m_event_tvalid(m_event_tvalid), .m_event_tready(m_event_tready),
        .m_event_tdata(m_event_tdata),
        .m_window_tvalid(m_window_tvalid), .m_window_tready(m_window_tready),
        .m_window_tdata(m_window_tdata), .m_window_tlast(m_window_tlast),
        .m_window_tuser(m_window_tuser),
        .m_match_tvalid(m_match_tvalid), .m_match_tready(m_match_tready),
        .m_match_tdata(m_match_tdata)
    );

    // Environment: a reset first; what is offered stays until it is taken
    logic        begun = 1'b0;
    logic        event_waited = 1'b0;
    logic [EVENT_BITS-1:0] event_before;
    always_ff @(posedge clk) begin
        begun        <= 1'b1;
        event_waited <= s_event_tvalid && !s_event_tready && !rst;
        event_before <= s_event_tdata;
    end
    always_comb begin
        if (!begun) assume (rst);
        if (event_waited && !rst) assume (s_event_tvalid && s_event_tdata == event_before);
    end

    logic running = 1'b0;
    always_ff @(posedge clk) running <= begun || rst;

    wire complete = m_window_tvalid && m_window_tready && m_window_tlast;
    wire taken    = m_match_tvalid && m_match_tready;

    // Progress: while an event is offered, it is taken, or a window or a match is complete, within
    // PROGRESS clocks in which the core waits for nobody. A core that ends no window any more fails.
    localparam STOOD_BITS = $clog2(PROGRESS + 2);
    logic [STOOD_BITS-1:0] stood;
    wire nobody_waits = m_event_tready && m_window_tready && m_match_tready && s_place_tvalid;
    always_ff @(posedge clk) begin
        if (rst || !s_event_tvalid || s_event_tready || complete || taken) stood <= '0;
        else if (nobody_waits && stood <= PROGRESS) stood <= stood + 1'b1;
    end

    always_comb if (running && !rst) assert (stood < PROGRESS);
endmodule
