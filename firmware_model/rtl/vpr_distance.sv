// Distances of a descriptor to all places, in the order of places, one every PERIOD clocks; those of the
// place filter (FILTER) with the bias of each place, from which the sum begins.
//
// After `follow_i`, the first place is compared while the descriptor is written, each word in the clock
// after it. The fixed period leaves the sequence unit its
// LENGTH clocks and the search its two, so that nothing within a match ever waits.
//
// With several gains there is a descriptor for each of SUMS sums of newest windows. All were written,
// `written_sum_i` with their words, before `follow_i` has that of `sum_i` compared.
module vpr_distance #(
    localparam int WORDS         = vpr_pkg::WORDS,
    localparam int SUMS          = vpr_pkg::SUMS,
    localparam int LANES         = vpr_pkg::LANES,
    localparam int LENGTH        = vpr_pkg::LENGTH,
    localparam int WORD_BITS     = vpr_pkg::WORD_BITS,
    localparam int SAD_BITS      = vpr_pkg::SAD_BITS,
    localparam int PLACES        = vpr_pkg::PLACES,
    localparam int PLACE_BITS    = vpr_pkg::PLACE_BITS,
    localparam int BIASED_BITS   = vpr_pkg::BIASED_BITS,
    localparam int BIAS_BITS     = vpr_pkg::PLACE_BIAS_BITS,
    localparam bit FILTER        = vpr_pkg::FILTER,
    parameter  bit LOADABLE      = 0,
    parameter  bit SLOW_BLOCKS   = 0  // a register behind the memories, see vpr_core
) (
    input  logic                       clk_i,
    input  logic                       rst_i,
    input  logic                       load_i,  // see vpr_rom
    input  logic [19:0]                load_address_i,
    input  logic [31:0]                load_word_i,
    input  logic                       query_write_i,
    input  logic [WORD_BITS-1:0]       query_inverse_i,  // of a word of the descriptor
    input  logic [1:0]                 written_sum_i,
    input  logic                       follow_i,
    input  logic [1:0]                 sum_i,
    output logic                       place_step_o,
    input  logic                       place_last_i,
    input  logic [WORD_BITS-1:0]       place_word_i,
    output logic                       distance_valid_o,
    output logic [BIASED_BITS-1:0]     distance_o
);
    // clocks a place: words of a distance, terms of a sum, and two of the search
    localparam int LONGER      = WORDS > LENGTH ? WORDS : LENGTH;
    localparam int PERIOD      = LONGER > 2 ? LONGER : 2;
    localparam int PERIOD_BITS = $clog2(PERIOD);
    localparam int QUERY_BITS  = WORDS > 1 ? $clog2(WORDS) : 1;
    localparam int DESCRIPTOR_BITS = QUERY_BITS + (SUMS > 1 ? 2 : 0);  // of an address in all of them
    // from an address to its word's sum: the memories, the differences, the levels of the tree
    localparam int LATENCY     = 2 + (SLOW_BLOCKS ? 1 : 0) + $clog2(LANES);

    logic                   running_q;
    logic                   following_q, written_q;  // the words of the descriptor, as they come
    logic                   reading_q;  // in the first WORDS clocks of a period
    logic [PERIOD_BITS-1:0] phase_q;
    logic [QUERY_BITS-1:0]  query_address_q;
    logic [QUERY_BITS-1:0]  write_address_q;
    logic [WORD_BITS-1:0]   query, codes, query_codes;
    logic [SAD_BITS-1:0]    sad;
    logic                   sad_lacks;
    logic [LATENCY-1:0]     valid_q, first_q, last_q;

    logic [BIASED_BITS-1:0] bias;
    wire                    begins = valid_q[LATENCY-1] && first_q[LATENCY-1];
    wire [BIASED_BITS-1:0]  so_far = first_q[LATENCY-1] ? bias : distance_o;

    wire end_phase = phase_q == PERIOD_BITS'(PERIOD - 1);
    wire end_word  = query_address_q == QUERY_BITS'(WORDS - 1);

    wire   goes       = running_q && (!following_q || written_q);
    assign place_step_o = goes && reading_q;

    // more lanes than slots: the sum has bits that a distance does not need
    wire unused = &{1'b0, sad};

    always_ff @(posedge clk_i) begin
        if (query_write_i)
            write_address_q <= write_address_q == QUERY_BITS'(WORDS - 1) ? '0 : write_address_q + 1'b1;
        written_q <= query_write_i;
        if (follow_i) begin
            running_q       <= 1'b1;
            reading_q       <= 1'b1;
            following_q     <= SUMS == 1;
            phase_q         <= '0;
            query_address_q <= '0;
        end else if (goes) begin
            phase_q <= end_phase ? '0 : phase_q + 1'b1;
            if (reading_q) begin
                query_address_q <= end_word ? '0 : query_address_q + 1'b1;
                if (end_word) following_q <= 1'b0;
                if (place_last_i) running_q <= 1'b0;
            end
            reading_q <= end_phase || (reading_q && !end_word);
        end
        valid_q <= LATENCY'({valid_q, place_step_o});
        first_q <= LATENCY'({first_q, query_address_q == 0});
        last_q  <= LATENCY'({last_q, end_word});
        // with a carry into the lowest bit
        if (valid_q[LATENCY-1])
            distance_o <= BIASED_BITS'(({so_far, 1'b1} + {BIASED_BITS'(sad), sad_lacks}) >> 1);
        distance_valid_o <= valid_q[LATENCY-1] && last_q[LATENCY-1];
        if (rst_i) begin
            running_q        <= 1'b0;
            write_address_q  <= '0;
            valid_q          <= '0;
            distance_valid_o <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(SUMS > 1 ? SUMS << QUERY_BITS : WORDS), .BITS(WORD_BITS), .ADDRESS_BITS(DESCRIPTOR_BITS)
    ) queries (
        .clk_i(clk_i), .write_i(query_write_i),
        .write_address_i(DESCRIPTOR_BITS'({written_sum_i, write_address_q})),
        .write_word_i(query_inverse_i),
        .read_i(1'b1), .read_address_i(DESCRIPTOR_BITS'({sum_i, query_address_q})),
        .read_word_o(query)
    );

    vpr_sad_lanes sad_lanes (
        .clk_i(clk_i), .a_i(codes), .b_inverse_i(query_codes), .sum_o(sad), .lacks_o(sad_lacks)
    );

    generate
        if (FILTER) begin : g_bias
            // the next is read when one was taken: a place takes two clocks at least
            logic [PLACE_BITS-1:0] place_q;
            logic [BIAS_BITS-1:0]  of_place;

            vpr_rom #(
                .DEPTH(PLACES), .BITS(BIAS_BITS), .ADDRESS_BITS(PLACE_BITS),
                .FILE("place_bias.mem"), .LOADABLE(LOADABLE), .STYLE("block")
            ) place_bias (
                .clk_i(clk_i), .enable_i(1'b1), .address_i(place_q), .word_o(of_place),
                .load_i(load_i), .load_address_i(load_address_i), .load_word_i(load_word_i)
            );

            assign bias = BIASED_BITS'(of_place);
            always_ff @(posedge clk_i) begin
                if (follow_i) place_q <= '0;
                else if (begins) place_q <= place_q + 1'b1;
            end
        end else begin : g_no_bias
            wire unused_load = &{1'b0, load_i, load_address_i, load_word_i, begins};
            assign bias = '0;
        end
        if (SLOW_BLOCKS) begin : g_registers
            logic [WORD_BITS-1:0] held_codes_q, held_query_q;
            always_ff @(posedge clk_i) begin
                held_codes_q <= place_word_i;
                held_query_q <= query;
            end
            assign codes       = held_codes_q;
            assign query_codes = held_query_q;
        end else begin : g_direct
            assign codes       = place_word_i;
            assign query_codes = query;
        end
    endgenerate
endmodule
