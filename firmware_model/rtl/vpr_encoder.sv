// Counts of the ended window to a descriptor: a slot a clock is read, cleared, and packed as it is,
// LANES codes a word, the first in the least significant bits. Lanes beyond the last slot are zero. The
// whole unit stands while a word is not taken. After reset it passes over all slots once, without a
// word, to clear them. `draining_o` holds while it needs the counters. Contrast codes (CONTRAST) need
// the mean over all slots: a first pass reads and clears them, without a word, and a second, behind
// the division, encodes.
//
// With several gains there is a descriptor of each of SUMS sums of newest windows (vpr_sums): `sum_o` is
// 2 of four windows, whose first pass alone needs the counters, then 1 of two, and 0 of the window.
module vpr_encoder #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int SUMS       = vpr_pkg::SUMS,
    localparam int WORDS      = vpr_pkg::WORDS,
    localparam int LANES      = vpr_pkg::LANES,
    localparam bit CONTRAST   = vpr_pkg::CONTRAST,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS = vpr_pkg::COUNT_BITS,
    localparam int LEVEL_BITS = vpr_pkg::LEVEL_BITS,
    localparam int CODE_BITS  = vpr_pkg::CODE_BITS,
    localparam int WORD_BITS  = vpr_pkg::WORD_BITS,
    parameter  bit LOADABLE   = 0
) (
    input  logic                       clk_i,
    input  logic                       rst_i,
    input  logic [1:0]                 load_i,  // see vpr_rom
    input  logic [19:0]                load_address_i,
    input  logic [31:0]                load_word_i,
    input  logic                       start_i,
    input  logic                       paused_i,
    output logic                       draining_o,
    output logic                       drain_o,
    output logic [SLOT_BITS-1:0]       drain_slot_o,
    input  logic [COUNT_BITS-1:0]      drained_i,
    input  logic [SLOT_BITS-1:0]       drained_slot_i,
    output logic                       word_valid_o,
    input  logic                       word_ready_i,
    output logic                       word_last_o,
    output logic [1:0]                 sum_o,
    output logic [WORD_BITS-1:0]       word_o
);
    // lanes beyond the last slot
    localparam int FILL      = WORDS * LANES - SLOTS;
    localparam int LANE_BITS = LANES > 1 ? $clog2(LANES) : 1;

    logic                 issuing_q, clearing_q;
    logic                 again, encodes_q;  // behind the first pass of two; in the pass that has words
    logic [SLOT_BITS-1:0] index_q;
    logic [LANE_BITS-1:0] lane_q;

    // behind the counters, and on the way to the code
    logic                 counted_q, counted_word_q, counted_last_q;
    logic                 coded_q, coded_word_q, coded_last_q;
    logic [CODE_BITS-1:0] code;

    // as the differences of codes take it
    logic [WORD_BITS-1:0]       word_inverse_q;
    assign word_o = ~word_inverse_q;

    // the newest lane above those before it, which move down by one, and at last to the end
    wire [WORD_BITS-1:0]       next_word = WORD_BITS'({code, word_o}
        >> (coded_last_q ? CODE_BITS * (FILL + 1) : CODE_BITS));

    wire step      = !word_valid_o || word_ready_i;
    wire end_index = index_q == SLOT_BITS'(SLOTS - 1);
    wire end_lane  = lane_q == LANE_BITS'(LANES - 1) || end_index;

    logic begins_q;    // a pass over all slots, behind a reset and of a next sum
    logic next_sum;
    wire  starts    = start_i || again || begins_q;
    logic counters_q;  // the pass is of the first sum, or clears

    assign draining_o   = (issuing_q || counted_q || begins_q) && !(CONTRAST && encodes_q) && counters_q;
    assign drain_o      = step && issuing_q;
    assign drain_slot_o = index_q;

    always_ff @(posedge clk_i) begin
        begins_q  <= next_sum || rst_i;
        issuing_q <= starts || (issuing_q && !(step && end_index));
        if (starts) begin
            encodes_q <= again;
            index_q   <= '0;
            lane_q    <= '0;
        end else if (step && issuing_q) begin
            index_q <= index_q + 1'b1;
            lane_q  <= end_lane ? '0 : lane_q + 1'b1;
        end
        if (step) begin
            counted_q        <= issuing_q;
            counted_word_q   <= issuing_q && end_lane;
            counted_last_q   <= end_index;
            coded_q          <= counted_q && (encodes_q || !CONTRAST);
            coded_word_q     <= counted_word_q && (CONTRAST ? encodes_q : !clearing_q);
            coded_last_q     <= counted_last_q;
            if (coded_q) word_inverse_q <= ~next_word;
            word_valid_o     <= coded_word_q;
            word_last_o      <= coded_last_q;
        end
        if (counted_q && counted_last_q && sum_o == 0) clearing_q <= 1'b0;
        if (rst_i) begin
            issuing_q      <= 1'b0;
            encodes_q      <= 1'b0;
            clearing_q     <= 1'b1;
            counted_q      <= 1'b0;
            counted_word_q <= 1'b0;
            coded_q        <= 1'b0;
            coded_word_q   <= 1'b0;
            word_valid_o   <= 1'b0;
        end
    end

    generate
        if (SUMS == 1) begin : g_one_sum
            assign sum_o      = '0;
            assign next_sum   = 1'b0;
            assign counters_q = 1'b1;
        end else begin : g_sums
            // behind its words; behind a reset there are none
            assign next_sum = sum_o != 0
                && (clearing_q ? counted_q && counted_last_q : word_valid_o && word_last_o);
            always_ff @(posedge clk_i)
                if (start_i || rst_i) begin
                    sum_o      <= 2'(SUMS - 1);
                    counters_q <= 1'b1;
                end else begin
                    if (next_sum) sum_o <= sum_o - 1'b1;
                    if (next_sum ? !clearing_q : sum_o == 0 && counted_q && counted_last_q) counters_q <= 1'b0;
                end
        end
        if (CONTRAST) begin : g_contrast
            logic                  count_valid, count_last, count_clearing;
            logic [SLOT_BITS-1:0]  count_slot;
            logic [COUNT_BITS-1:0] count;
            logic                  deviates, deviating_last;
            logic [SLOT_BITS-1:0]  deviating_slot;
            logic [LEVEL_BITS+1:0] deviation;

            if (SUMS == 1) begin : g_counts
                assign count_valid    = counted_q && !encodes_q;
                assign count_last     = counted_q && counted_last_q && !encodes_q;
                assign count_clearing = clearing_q;
                assign count_slot     = drained_slot_i;
                assign count          = drained_i;
            end else begin : g_sums_of_counts
                wire unused = &{1'b0, drained_slot_i};
                vpr_sums sums (
                    .clk_i(clk_i), .rst_i(rst_i), .step_i(step), .sum_i(sum_o), .slot_i(index_q),
                    .clearing_i(clearing_q), .valid_i(counted_q && !encodes_q),
                    .last_i(counted_q && counted_last_q && !encodes_q), .drained_i(drained_i),
                    .valid_o(count_valid), .last_o(count_last), .clearing_o(count_clearing),
                    .slot_o(count_slot), .count_o(count)
                );
            end

            vpr_running_mean #(.LOADABLE(LOADABLE)) running_mean (
                .clk_i(clk_i), .rst_i(rst_i), .load_i(load_i),
                .load_address_i(load_address_i),
                .load_word_i(load_word_i), .step_i(step), .clearing_i(count_clearing), .hold_i(paused_i),
                .valid_i(count_valid), .last_i(count_last), .newest_i(sum_o == 0),
                .slot_i(count_slot), .count_i(count), .deviates_o(deviates),
                .deviating_last_o(deviating_last), .deviating_slot_o(deviating_slot),
                .deviation_o(deviation)
            );
            vpr_contrast contrast (
                .clk_i(clk_i), .rst_i(rst_i), .clear_i(start_i || begins_q), .deviates_i(deviates),
                .last_i(deviating_last), .deviating_slot_i(deviating_slot),
                .deviation_i(deviation), .divided_o(again), .step_i(step), .slot_i(index_q),
                .code_o(code)
            );
        end else begin : g_counts
            wire unused = &{1'b0, paused_i, load_i, load_address_i, load_word_i, drained_slot_i};
            assign again = 1'b0;
            always_ff @(posedge clk_i) if (step) code <= drained_i;
        end
    endgenerate
endmodule
