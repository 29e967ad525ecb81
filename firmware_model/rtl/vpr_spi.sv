// SPI slave before the core: mode 0, the most significant bit of a byte first, the least significant
// byte of a value first. `sck` may have up to a sixth of the frequency of `clk`.
//
// A frame, while `ss_n` is low, is a command byte and its values:
//   0x01  events, each as in events.bin
//   0x02  words of places.mem, each in whole bytes
//   0x03  start time in whole bytes, and with pauses (see vpr_activity) four of the usual number of
//         events in a window: with its last byte the device begins anew
//   0x04  bytes of the match in `miso`, as a word of expected_matches.mem, filled up with zeros; with
//         the last of them the match is taken
// With every other byte, `miso` gives the status: bit 0 an event or a word of places can be sent, bit
// 1 there is a match, bit 7 something was sent too early and is lost, since the last start.
module vpr_spi #(
    parameter int EVENT_BITS = 64,
    parameter int PLACE_BITS = 8,
    parameter int START_BITS = 32,  // whole bytes
    parameter int MATCH_BITS = 8
) (
    input  logic                  clk,
    input  logic                  sck,
    input  logic                  ss_n,
    input  logic                  mosi,
    output logic                  miso,

    output logic                  start,
    output logic [START_BITS-1:0] start_value,
    output logic                  event_tvalid,
    input  logic                  event_tready,
    output logic [EVENT_BITS-1:0] event_tdata,
    output logic                  place_tvalid,
    input  logic                  place_tready,
    output logic [PLACE_BITS-1:0] place_tdata,
    input  logic                  match_tvalid,
    output logic                  match_tready,
    input  logic [MATCH_BITS-1:0] match_tdata
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
    logic [2:0] sck_seen;
    logic [1:0] ss_n_seen, mosi_seen;
    always_ff @(posedge clk) begin
        sck_seen  <= {sck_seen[1:0], sck};
        ss_n_seen <= {ss_n_seen[0], ss_n};
        mosi_seen <= {mosi_seen[0], mosi};
    end
    wire idle = ss_n_seen[1];
    wire rise = sck_seen[2:1] == 2'b01;
    wire fall = sck_seen[2:1] == 2'b10;

    // bytes
    logic [2:0] bit_index;
    logic [7:0] bits, answer;
    logic       commanded, got_byte, got_command;
    logic       of_events, of_places, of_start, of_match;
    always_ff @(posedge clk) begin
        got_byte    <= 1'b0;
        got_command <= 1'b0;
        if (idle) begin
            bit_index <= '0;
            commanded <= 1'b0;
        end else if (rise) begin
            bit_index <= bit_index + 1'b1;
            bits      <= {bits[6:0], mosi_seen[1]};
            if (bit_index == 3'd7) begin
                commanded   <= 1'b1;
                got_byte    <= commanded;
                got_command <= !commanded;
            end
        end
        // `bits` stay for some clocks
        if (got_command) begin
            of_events <= bits == EVENTS;
            of_places <= bits == PLACES;
            of_start  <= bits == START;
            of_match  <= bits == MATCH;
        end
    end

    // values, their bytes moved in from the top
    logic [8*WIDER-1:0]    value;
    logic [INDEX_BITS-1:0] index;
    logic                  complete, lost;
    logic [INDEX_BITS-1:0] last_index;
    wire                   room = !event_tvalid && !place_tvalid;

    always_ff @(posedge clk) begin
        last_index <= of_events ? INDEX_BITS'(EVENT_BYTES - 1)
                    : of_places ? INDEX_BITS'(PLACE_BYTES - 1)
                    : of_start ? INDEX_BITS'(START_BYTES - 1) : INDEX_BITS'(MATCH_BYTES - 1);
        complete <= got_byte && index == last_index;
        if (got_command) index <= '0;
        else if (got_byte) index <= index == last_index ? '0 : index + 1'b1;
        // what waits to be taken stays, and what is sent meanwhile is lost
        if (got_byte && room) value <= (8 * WIDER)'({bits, value} >> 8);
        if (got_byte && !room && !of_match) lost <= 1'b1;

        start        <= complete && of_start;
        match_tready <= complete && of_match;
        event_tvalid <= !start && ((complete && of_events) || (event_tvalid && !event_tready));
        place_tvalid <= !start && ((complete && of_places) || (place_tvalid && !place_tready));
        if (start) lost <= 1'b0;
    end

    assign event_tdata = value[8*WIDER-1-:EVENT_BITS];
    assign place_tdata = value[8*(WIDER-PLACE_BYTES)+:PLACE_BITS];

    // stays for some clocks after `start`
    assign start_value = value[8*WIDER-1-:START_BITS];

    // answers
    wire [8*MATCH_BYTES-1:0] match_bytes = (8 * MATCH_BYTES)'(match_tdata);
    wire [7:0]               status      = {lost, 5'b0, match_tvalid, room};

    always_ff @(posedge clk) begin
        if (bit_index == 0 && !rise) begin
            if (commanded && of_match) answer <= match_bytes[8*index+:8];
            else answer <= status;
        end else if (fall) answer <= {answer[6:0], 1'b0};
    end

    assign miso = answer[7];
endmodule
