// Registers of the device on AXI4-Lite, as vpr_registers has them: start, tables and places, events,
// and matches. Events may also come by `s_event`.
//
// A write that comes too early, or to no register, is answered by SLVERR and lost: the bus never
// waits for a match. One write and one read are under way at a time. `match_waits_o` is high while
// there is a match.
module vpr_axi_lite #(
    localparam int EVENT_BITS      = vpr_pkg::EVENT_BITS,
    localparam int EVENT_TIME_BITS = vpr_pkg::EVENT_TIME_BITS,
    localparam int TIMESTAMP_BITS  = vpr_pkg::TIMESTAMP_BITS,
    localparam int ACTIVITY_BITS   = vpr_pkg::ACTIVITY_BITS,
    localparam int WORD_BITS       = vpr_pkg::WORD_BITS,
    localparam int PLACE_BITS      = vpr_pkg::PLACE_BITS,
    localparam int SUM_BITS        = vpr_pkg::SUM_BITS,
    localparam int TRUST_BITS      = vpr_pkg::TRUST_BITS,
    localparam int MATCH_BITS      = vpr_pkg::MATCH_BITS,
    parameter      MEMORY_STYLE    = "auto",  // see vpr_core
    parameter      PLACES_FILE     = "",      // see vpr_core
    parameter      LOADABLE        = 1        // see vpr_core
) (
    input  logic        aclk,
    input  logic        aresetn,

    input  logic        s_axi_awvalid,
    output logic        s_axi_awready,
    input  logic [7:0]  s_axi_awaddr,
    input  logic        s_axi_wvalid,
    output logic        s_axi_wready,
    input  logic [31:0] s_axi_wdata,
    output logic        s_axi_bvalid,
    input  logic        s_axi_bready,
    output logic [1:0]  s_axi_bresp,
    input  logic        s_axi_arvalid,
    output logic        s_axi_arready,
    input  logic [7:0]  s_axi_araddr,
    output logic        s_axi_rvalid,
    input  logic        s_axi_rready,
    output logic [31:0] s_axi_rdata,
    output logic [1:0]  s_axi_rresp,

    input  logic        s_event_tvalid,
    output logic        s_event_tready,
    input  logic [EVENT_BITS-1:0] s_event_tdata,

    output logic        match_waits_o
);
    localparam logic [1:0] OKAY   = 2'b00;
    localparam logic [1:0] SLVERR = 2'b10;

    localparam int PARTS     = (WORD_BITS + 31) / 32;
    localparam int PART_BITS = $clog2(PARTS + 1);

    // A write is taken when address and data are there
    logic       taken_q;
    logic [7:0] address;
    wire        write = s_axi_awvalid && s_axi_wvalid && !s_axi_bvalid && !taken_q;

    assign s_axi_awready = taken_q;
    assign s_axi_wready  = taken_q;
    assign address       = s_axi_awaddr & 8'hFC;

    logic [63:0]           start_q, event_time_q;
    logic [31:0]           activity_q, event_pixel_q, table_word_q;
    logic [6:0]            load_q;
    logic [2:0]            selected_q;  // table
    logic [19:0]           table_address_q;
    logic [32*PARTS-1:0]   place_q;
    logic [PART_BITS-1:0]  parts_q;
    logic                  restart_q, event_waits_q, place_waits_q, take_match_q;
    logic                  event_tready, place_tready, match_tvalid;
    logic [MATCH_BITS-1:0] match_word;

    wire place_ready = place_tready && !place_waits_q;

    always_ff @(posedge aclk) begin
        taken_q      <= write;
        restart_q    <= 1'b0;
        load_q       <= '0;
        take_match_q <= 1'b0;
        if (event_waits_q && event_tready) event_waits_q <= 1'b0;
        if (place_waits_q && place_tready) place_waits_q <= 1'b0;
        if (load_q != 0) table_address_q <= table_address_q + 1'b1;
        if (s_axi_bready) s_axi_bvalid <= 1'b0;
        if (taken_q) s_axi_bvalid <= 1'b1;
        if (write) begin
            s_axi_bresp <= OKAY;
            case (address)
                vpr_registers::CONTROL:         restart_q <= s_axi_wdata[0];
                vpr_registers::START:           start_q[31:0] <= s_axi_wdata;
                vpr_registers::START_HIGH:      start_q[63:32] <= s_axi_wdata;
                vpr_registers::ACTIVITY:        activity_q <= s_axi_wdata;
                vpr_registers::EVENT_TIME:      event_time_q[31:0] <= s_axi_wdata;
                vpr_registers::EVENT_TIME_HIGH: event_time_q[63:32] <= s_axi_wdata;
                vpr_registers::EVENT_PIXEL:
                    if (event_waits_q) s_axi_bresp <= SLVERR;
                    else begin
                        event_pixel_q <= s_axi_wdata;
                        event_waits_q <= 1'b1;
                    end
                vpr_registers::PLACE:
                    if (!place_ready) s_axi_bresp <= SLVERR;
                    else begin
                        place_q       <= (32 * PARTS)'({s_axi_wdata, place_q} >> 32);
                        parts_q       <= parts_q == PART_BITS'(PARTS - 1) ? '0 : parts_q + 1'b1;
                        place_waits_q <= parts_q == PART_BITS'(PARTS - 1);
                    end
                vpr_registers::TABLE_ADDRESS: {selected_q, table_address_q} <=
                    {s_axi_wdata[26:24], s_axi_wdata[19:0]};
                vpr_registers::TABLE_WORD: begin
                    table_word_q <= s_axi_wdata;
                    load_q       <= 7'd1 << selected_q;
                end
                vpr_registers::MATCH_TAKE:
                    if (match_tvalid) take_match_q <= 1'b1;
                    else s_axi_bresp <= SLVERR;
                default: s_axi_bresp <= SLVERR;
            endcase
        end
        if (restart_q) begin
            parts_q       <= '0;
            event_waits_q <= 1'b0;
            place_waits_q <= 1'b0;
        end
        if (!aresetn) begin
            taken_q        <= 1'b0;
            restart_q      <= 1'b1;
            load_q         <= '0;
            take_match_q   <= 1'b0;
            event_waits_q  <= 1'b0;
            place_waits_q  <= 1'b0;
            parts_q        <= '0;
            s_axi_bvalid <= 1'b0;
        end
    end

    // The match, fields of a word of expected_matches.mem
    logic                              accepted, has_second;
    logic [PLACE_BITS-1:0] best, second, ties;
    logic [SUM_BITS-1:0]   best_sum, second_sum;
    logic [TRUST_BITS-1:0] trust;
    logic [31:0]                       window;
    localparam int UNPACKED_BITS = MATCH_BITS + TRUST_BITS;
    assign {trust, accepted, ties, second_sum, second, has_second, best_sum, best, window} =
        ($bits(window) + 3 * PLACE_BITS + 2 * SUM_BITS
         + 2 + TRUST_BITS)'(UNPACKED_BITS'(match_word));

    assign s_axi_arready = !s_axi_rvalid;

    always_ff @(posedge aclk) begin
        if (s_axi_rready) s_axi_rvalid <= 1'b0;
        if (s_axi_arvalid && s_axi_arready) begin
            s_axi_rvalid <= 1'b1;
            s_axi_rresp  <= OKAY;
            case (s_axi_araddr & 8'hFC)
                vpr_registers::ID:            s_axi_rdata <= vpr_registers::ID_VALUE;
                vpr_registers::DESIGN:        s_axi_rdata <= vpr_pkg::DESIGN_CRC;
                vpr_registers::STATUS:        s_axi_rdata <=
                    {29'b0, match_tvalid, !event_waits_q, place_ready};
                vpr_registers::START:         s_axi_rdata <= start_q[31:0];
                vpr_registers::START_HIGH:    s_axi_rdata <= start_q[63:32];
                vpr_registers::ACTIVITY:      s_axi_rdata <= activity_q;
                vpr_registers::MATCH_WINDOW:  s_axi_rdata <= window;
                vpr_registers::MATCH_PLACE:   s_axi_rdata <= 32'(best);
                vpr_registers::MATCH_SUM:     s_axi_rdata <= 32'(best_sum);
                vpr_registers::MATCH_SECOND:  s_axi_rdata <= has_second ? 32'(second) : '1;
                vpr_registers::MATCH_SECOND_SUM:
                    s_axi_rdata <= has_second ? 32'(second_sum) : '1;
                vpr_registers::MATCH_TIES:     s_axi_rdata <= 32'(ties);
                vpr_registers::MATCH_ACCEPTED: s_axi_rdata <= {31'b0, accepted};
                vpr_registers::MATCH_TRUST:    s_axi_rdata <= 32'(trust);
                default: begin
                    s_axi_rdata <= '0;
                    s_axi_rresp <= SLVERR;
                end
            endcase
        end
        if (!aresetn) s_axi_rvalid <= 1'b0;
    end

    // Events of the bus go before those of the stream
    wire [EVENT_BITS-1:0] event_tdata = event_waits_q
        ? {event_pixel_q, event_time_q[EVENT_TIME_BITS-1:0]} : s_event_tdata;

    assign s_event_tready = event_tready && !event_waits_q;
    assign match_waits_o      = match_tvalid;

    // verilator lint_off PINCONNECTEMPTY
    vpr_core #(
        .MEMORY_STYLE(MEMORY_STYLE), .PLACES_FILE(PLACES_FILE), .LOADABLE(LOADABLE)
    ) core (
        .clk_i(aclk), .rst_i(restart_q || !aresetn), .load_i(load_q), .load_address_i(table_address_q),
        .load_word_i(table_word_q), .start_time_i(start_q[TIMESTAMP_BITS-1:0]),
        .start_activity_i(activity_q[ACTIVITY_BITS-1:0]),
        .s_place_tvalid(place_waits_q), .s_place_tready(place_tready),
        .s_place_tdata(place_q[WORD_BITS-1:0]),
        .s_event_tvalid(event_waits_q || s_event_tvalid), .s_event_tready(event_tready),
        .s_event_tdata(event_tdata),
        .m_event_tvalid(), .m_event_tready(1'b1), .m_event_tdata(),
        .m_window_tvalid(), .m_window_tready(1'b1), .m_window_tdata(), .m_window_tlast(),
        .m_window_tuser(),
        .m_match_tvalid(match_tvalid), .m_match_tready(take_match_q), .m_match_tdata(match_word)
    );
    // verilator lint_on PINCONNECTEMPTY

    wire unused = &{1'b0, start_q, event_time_q, activity_q, place_q, s_axi_awaddr, s_axi_araddr};
endmodule
