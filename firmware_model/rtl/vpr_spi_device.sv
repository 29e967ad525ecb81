// The device behind SPI, as all boards have it: `locked_i` is low until `clk_i` stands. `ready_o` is
// high while an event can be sent, `match_o` while there is a match to read.
module vpr_spi_device #(
    localparam bit PAUSES         = vpr_pkg::PAUSES,
    localparam int EVENT_BITS     = vpr_pkg::EVENT_BITS,
    localparam int TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam int ACTIVITY_BITS  = vpr_pkg::ACTIVITY_BITS,
    localparam int WORD_BITS      = vpr_pkg::WORD_BITS,
    localparam int MATCH_BITS     = vpr_pkg::MATCH_BITS,
    parameter      MEMORY_STYLE   = "auto",  // of the places and of past distances, see vpr_ram_single
    parameter      SLOW_BLOCKS    = 0        // see vpr_core
) (
    input  logic clk_i,
    input  logic locked_i,
    input  logic sck_i,
    input  logic ss_n_i,
    input  logic mosi_i,
    output logic miso_o,
    output logic ready_o,
    output logic match_o
);
    localparam int TIME_BITS  = 8 * ((TIMESTAMP_BITS + 7) / 8);
    localparam int START_BITS = TIME_BITS + (PAUSES ? 32 : 0);

    // in reset until the clock stands, and when the host starts anew
    logic [1:0] stands_q;
    logic       rst_q, start;
    always_ff @(posedge clk_i) begin
        stands_q <= {stands_q[0], locked_i};
        rst_q    <= !stands_q[1] || start;
    end

    logic [START_BITS-1:0]     start_value;
    logic                      event_tvalid, event_tready;
    logic                      place_tvalid, place_tready;
    logic                      match_tvalid, match_tready;
    logic [EVENT_BITS-1:0]     event_tdata;
    logic [WORD_BITS-1:0]      place_tdata;
    logic [MATCH_BITS-1:0]     match_tdata;

    vpr_spi #(
        .EVENT_BITS(EVENT_BITS), .PLACE_BITS(WORD_BITS),
        .START_BITS(START_BITS), .MATCH_BITS(MATCH_BITS)
    ) spi (
        .clk_i(clk_i), .sck_i(sck_i), .ss_n_i(ss_n_i), .mosi_i(mosi_i), .miso_o(miso_o),
        .start_o(start), .start_value_o(start_value),
        .event_tvalid_o(event_tvalid), .event_tready_i(event_tready), .event_tdata_o(event_tdata),
        .place_tvalid_o(place_tvalid), .place_tready_i(place_tready), .place_tdata_o(place_tdata),
        .match_tvalid_i(match_tvalid), .match_tready_o(match_tready), .match_tdata_i(match_tdata)
    );

    vpr_core #(
        .MEMORY_STYLE(MEMORY_STYLE), .SLOW_BLOCKS(SLOW_BLOCKS)
    ) core (
        .clk_i(clk_i), .rst_i(rst_q), .load_i('0), .load_address_i('0), .load_word_i('0),
        .start_time_i(start_value[TIMESTAMP_BITS-1:0]),
        .start_activity_i(ACTIVITY_BITS'(start_value >> TIME_BITS)),
        .s_place_tvalid(place_tvalid), .s_place_tready(place_tready), .s_place_tdata(place_tdata),
        .s_event_tvalid(event_tvalid), .s_event_tready(event_tready), .s_event_tdata(event_tdata),
        .m_event_tvalid(), .m_event_tready(1'b1), .m_event_tdata(),
        .m_window_tvalid(), .m_window_tready(1'b1), .m_window_tdata(), .m_window_tlast(),
        .m_window_tuser(),
        .m_match_tvalid(match_tvalid), .m_match_tready(match_tready), .m_match_tdata(match_tdata)
    );

    assign ready_o = !event_tvalid;
    assign match_o = match_tvalid;
endmodule
