// SPI slave before the core: mode 0, the most significant bit of a byte first, the least significant
// byte of a value first. `sck_i` may have up to a sixth of the frequency of `clk_i`.
//
// A frame, while `ss_n_i` is low, is a command byte and its values:
//   0x01  events, each as in events.bin
//   0x02  words of places.mem, each in whole bytes
//   0x03  start time in whole bytes, and with pauses (see vpr_activity) four bytes of the mean number
//         of events in a window: the device restarts with the last byte
//   0x04  bytes of the match in `miso_o`, as a word of expected_matches.mem, filled up with zeros; with
//         the last of them the match is taken
// With every other byte, `miso_o` gives the status: bit 0 an event or a word of places can be sent, bit
// 1 there is a match, bit 7 something was sent too early and is lost, since the last start.
module vpr_spi #(
    parameter int EVENT_BITS = 64,
    parameter int PLACE_BITS = 8,
    parameter int START_BITS = 32,  // whole bytes
    parameter int MATCH_BITS = 8
) (
    input  logic                  clk_i,
    input  logic                  sck_i,
    input  logic                  ss_n_i,
    input  logic                  mosi_i,
    output logic                  miso_o,

    output logic                  start_o,
    output logic [START_BITS-1:0] start_value_o,
    output logic                  event_tvalid_o,
    input  logic                  event_tready_i,
    output logic [EVENT_BITS-1:0] event_tdata_o,
    output logic                  place_tvalid_o,
    input  logic                  place_tready_i,
    output logic [PLACE_BITS-1:0] place_tdata_o,
    input  logic                  match_tvalid_i,
    output logic                  match_tready_o,
    input  logic [MATCH_BITS-1:0] match_tdata_i
);
    localparam int EVENT_BYTES = EVENT_BITS / 8;
    localparam int PLACE_BYTES = (PLACE_BITS + 7) / 8;
    localparam int START_BYTES = START_BITS / 8;
    localparam int MATCH_BYTES = (MATCH_BITS + 7) / 8;
    localparam int WIDE        = EVENT_BYTES > PLACE_BYTES ? EVENT_BYTES : PLACE_BYTES;
    localparam int WIDER       = WIDE > START_BYTES ? WIDE : START_BYTES;
    localparam int LONGER      = WIDER > MATCH_BYTES ? WIDER : MATCH_BYTES;
    localparam int INDEX_BITS  = $clog2(LONGER + 1);

    localparam logic [7:0] EVENTS = 8'h01;
    localparam logic [7:0] PLACES = 8'h02;
    localparam logic [7:0] START  = 8'h03;
    localparam logic [7:0] MATCH  = 8'h04;

    // into the domain of clk
    logic [2:0] sck_seen_q;
    logic [1:0] ss_n_seen_q, mosi_seen_q;
    always_ff @(posedge clk_i) begin
        sck_seen_q  <= {sck_seen_q[1:0], sck_i};
        ss_n_seen_q <= {ss_n_seen_q[0], ss_n_i};
        mosi_seen_q <= {mosi_seen_q[0], mosi_i};
    end
    wire idle = ss_n_seen_q[1];
    wire rise = sck_seen_q[2:1] == 2'b01;
    wire fall = sck_seen_q[2:1] == 2'b10;

    // bytes
    logic [2:0] bit_index_q;
    logic [7:0] bits_q, answer_q;
    logic       commanded_q, got_byte_q, got_command_q;
    logic       of_events_q, of_places_q, of_start_q, of_match_q;
    always_ff @(posedge clk_i) begin
        got_byte_q    <= 1'b0;
        got_command_q <= 1'b0;
        if (idle) begin
            bit_index_q <= '0;
            commanded_q <= 1'b0;
        end else if (rise) begin
            bit_index_q <= bit_index_q + 1'b1;
            bits_q      <= {bits_q[6:0], mosi_seen_q[1]};
            if (bit_index_q == 3'd7) begin
                commanded_q   <= 1'b1;
                got_byte_q    <= commanded_q;
                got_command_q <= !commanded_q;
            end
        end
        // `bits_q` stay for some clocks
        if (got_command_q) begin
            of_events_q <= bits_q == EVENTS;
            of_places_q <= bits_q == PLACES;
            of_start_q  <= bits_q == START;
            of_match_q  <= bits_q == MATCH;
        end
    end

    // values, their bytes moved in from the top
    logic [8*WIDER-1:0]    value_q;
    logic [INDEX_BITS-1:0] index_q;
    logic                  complete_q, lost_q;
    logic [INDEX_BITS-1:0] last_index_q;
    wire                   room = !event_tvalid_o && !place_tvalid_o;

    always_ff @(posedge clk_i) begin
        last_index_q <= of_events_q ? INDEX_BITS'(EVENT_BYTES - 1)
                    : of_places_q ? INDEX_BITS'(PLACE_BYTES - 1)
                    : of_start_q ? INDEX_BITS'(START_BYTES - 1) : INDEX_BITS'(MATCH_BYTES - 1);
        complete_q <= got_byte_q && index_q == last_index_q;
        if (idle) index_q <= '0;
        else if (got_byte_q) index_q <= index_q == last_index_q ? '0 : index_q + 1'b1;
        // what waits to be taken stays, and what is sent meanwhile is lost
        if (got_byte_q && room) value_q <= (8 * WIDER)'({bits_q, value_q} >> 8);
        if (got_byte_q && !room && !of_match_q) lost_q <= 1'b1;

        start_o        <= complete_q && of_start_q;
        match_tready_o <= complete_q && of_match_q;
        event_tvalid_o <= !start_o && ((complete_q && of_events_q) || (event_tvalid_o && !event_tready_i));
        place_tvalid_o <= !start_o && ((complete_q && of_places_q) || (place_tvalid_o && !place_tready_i));
        if (start_o) lost_q <= 1'b0;
    end

    assign event_tdata_o = value_q[8*WIDER-1-:EVENT_BITS];
    assign place_tdata_o = value_q[8*(WIDER-PLACE_BYTES)+:PLACE_BITS];

    // stays for some clocks after `start_o`
    assign start_value_o = value_q[8*WIDER-1-:START_BITS];

    // answers
    logic [8*MATCH_BYTES-1:0] match_q;  // of the match, from the byte of `index_q` on
    wire  [7:0]               status = {lost_q, 5'b0, match_tvalid_i, room};

    always_ff @(posedge clk_i) begin
        if (got_byte_q) match_q <= match_q >> 8;
        else if (index_q == 0) match_q <= (8 * MATCH_BYTES)'(match_tdata_i);
        if (bit_index_q == 0 && !rise) begin
            if (commanded_q && of_match_q) answer_q <= match_q[7:0];
            else answer_q <= status;
        end else if (fall) answer_q <= {answer_q[6:0], 1'b0};
    end

    assign miso_o = answer_q[7];
endmodule
