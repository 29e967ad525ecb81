// Distances of a descriptor to all places, in the order of places, one every PERIOD clocks.
//
// After `follow`, the first place is compared while the descriptor is written, each word in the clock
// after it; after `start`, with what was written. The fixed period leaves the sequence unit its
// LENGTH clocks and the search its two, so that nothing within a match ever waits.
module vpr_distance #(
    localparam int WORDS         = vpr_pkg::WORDS,
    localparam int LANES         = vpr_pkg::LANES,
    localparam int LENGTH        = vpr_pkg::LENGTH,
    localparam int WORD_BITS     = vpr_pkg::WORD_BITS,
    localparam int SAD_BITS      = vpr_pkg::SAD_BITS,
    localparam int DISTANCE_BITS = vpr_pkg::DISTANCE_BITS,
    parameter  bit SLOW_BLOCKS   = 0  // a register behind the memories, see vpr_core
) (
    input  logic                       clk,
    input  logic                       rst,
    input  logic                       query_write,
    input  logic [WORD_BITS-1:0]       query_inverse,  // of a word of the descriptor
    input  logic                       follow,
    input  logic                       start,
    output logic                       place_step,
    input  logic                       place_last,
    input  logic [WORD_BITS-1:0]       place_word,
    output logic                       distance_valid,
    output logic [DISTANCE_BITS-1:0]   distance
);
    // clocks a place: words of a distance, terms of a sum, and two of the search
    localparam int LONGER      = WORDS > LENGTH ? WORDS : LENGTH;
    localparam int PERIOD      = LONGER > 2 ? LONGER : 2;
    localparam int PERIOD_BITS = $clog2(PERIOD);
    localparam int QUERY_BITS  = WORDS > 1 ? $clog2(WORDS) : 1;
    // from an address to its word's sum: the memories, the differences, the levels of the tree
    localparam int LATENCY     = 2 + (SLOW_BLOCKS ? 1 : 0) + $clog2(LANES);

    logic                   running;
    logic                   following, written;  // the words of the descriptor, as they come
    logic                   reading;  // in the first WORDS clocks of a period
    logic [PERIOD_BITS-1:0] phase;
    logic [QUERY_BITS-1:0]  query_address;
    logic [QUERY_BITS-1:0]  write_address;
    logic [WORD_BITS-1:0]   query, codes, query_codes;
    logic [SAD_BITS-1:0]    sad;
    logic                   sad_lacks;
    logic [LATENCY-1:0]     valid, first, last;

    wire [DISTANCE_BITS-1:0] so_far = first[LATENCY-1] ? '0 : distance;

    wire end_phase = phase == PERIOD_BITS'(PERIOD - 1);
    wire end_word  = query_address == QUERY_BITS'(WORDS - 1);

    wire   goes       = running && (!following || written);
    assign place_step = goes && reading;

    // more lanes than slots: the sum has bits that a distance does not need
    wire unused = &{1'b0, sad};

    always_ff @(posedge clk) begin
        if (query_write)
            write_address <= write_address == QUERY_BITS'(WORDS - 1) ? '0 : write_address + 1'b1;
        written <= query_write;
        if (start || follow) begin
            running       <= 1'b1;
            reading       <= 1'b1;
            following     <= follow;
            phase         <= '0;
            query_address <= '0;
        end else if (goes) begin
            phase <= end_phase ? '0 : phase + 1'b1;
            if (reading) begin
                query_address <= end_word ? '0 : query_address + 1'b1;
                if (end_word) following <= 1'b0;
                if (place_last) running <= 1'b0;
            end
            reading <= end_phase || (reading && !end_word);
        end
        valid <= LATENCY'({valid, place_step});
        first <= LATENCY'({first, query_address == 0});
        last  <= LATENCY'({last, end_word});
        // with a carry into the lowest bit
        if (valid[LATENCY-1])
            distance <= DISTANCE_BITS'(({so_far, 1'b1} + {DISTANCE_BITS'(sad), sad_lacks}) >> 1);
        distance_valid <= valid[LATENCY-1] && last[LATENCY-1];
        if (rst) begin
            running        <= 1'b0;
            write_address  <= '0;
            valid          <= '0;
            distance_valid <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(WORDS), .BITS(WORD_BITS), .ADDRESS_BITS(QUERY_BITS)
    ) queries (
        .clk(clk), .write(query_write), .write_address(write_address), .write_word(query_inverse),
        .read(1'b1), .read_address(query_address), .read_word(query)
    );

    vpr_sad_lanes sad_lanes (
        .clk(clk), .a(codes), .b_inverse(query_codes), .sum(sad), .lacks(sad_lacks)
    );

    generate
        if (SLOW_BLOCKS) begin : g_registers
            logic [WORD_BITS-1:0] held_codes, held_query;
            always_ff @(posedge clk) begin
                held_codes <= place_word;
                held_query <= query;
            end
            assign codes       = held_codes;
            assign query_codes = held_query;
        end else begin : g_direct
            assign codes       = place_word;
            assign query_codes = query;
        end
    endgenerate
endmodule
