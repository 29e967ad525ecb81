// Counts of the ended window to a descriptor: a slot a clock is read, cleared, encoded by its code
// table, or against its running mean (OWN_MEAN), and packed, LANES codes a word, the first in the
// least significant bits. Lanes beyond the last slot are zero. The whole unit stands while a word is
// not taken. After reset it passes over all slots once, without a word, to clear them. `draining`
// holds while it needs the counters. Codes of contrast (CONTRAST) need the mean over all slots: a
// first pass reads and clears them, without a word, and a second, behind the division, encodes.
module vpr_encoder #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int WORDS      = vpr_pkg::WORDS,
    localparam int LANES      = vpr_pkg::LANES,
    localparam int TABLES     = vpr_pkg::TABLES,
    localparam int COUNT_MAX  = vpr_pkg::COUNT_MAX,
    localparam bit OWN_MEAN   = vpr_pkg::OWN_MEAN,
    localparam bit CONTRAST   = vpr_pkg::CONTRAST,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS = vpr_pkg::COUNT_BITS,
    localparam int TABLE_BITS = vpr_pkg::TABLE_BITS,
    localparam int ENTRY_BITS = vpr_pkg::ENTRY_BITS,
    localparam int CODE_BITS  = vpr_pkg::CODE_BITS,
    localparam int WORD_BITS  = vpr_pkg::WORD_BITS,
    parameter  bit LOADABLE   = 0
) (
    input  logic                       clk,
    input  logic                       rst,
    input  logic [2:0]                 load,  // see vpr_rom
    input  logic [19:0]                load_address,
    input  logic [31:0]                load_word,
    input  logic                       start,
    input  logic                       paused,
    output logic                       draining,
    output logic                       drain,
    output logic [SLOT_BITS-1:0]       drain_slot,
    input  logic [COUNT_BITS-1:0]      drained,
    input  logic [SLOT_BITS-1:0]       drained_slot,
    output logic                       word_valid,
    input  logic                       word_ready,
    output logic                       word_last,
    output logic [WORD_BITS-1:0]       word
);
    // lanes beyond the last slot
    localparam int FILL         = WORDS * LANES - SLOTS;
    localparam int LANE_BITS    = LANES > 1 ? $clog2(LANES) : 1;
    localparam int STRIDE       = COUNT_MAX + 1;
    localparam int ENTRIES      = TABLES * STRIDE;
    localparam int INDEXED_BITS = $clog2(ENTRIES);
    // steps from a count to its code
    localparam int STAGES       = OWN_MEAN && !CONTRAST ? 3 : 1;

    logic                 issuing, clearing;
    logic                 again, encodes;  // behind the first pass of two; in the pass that has words
    logic [SLOT_BITS-1:0] index;
    logic [LANE_BITS-1:0] lane;

    // behind the counters, and on the way to the code
    logic                 counted, counted_word, counted_last;
    logic [STAGES-1:0]    coded, coded_word, coded_last;
    logic [CODE_BITS-1:0] code;

    // as the differences of codes take it
    logic [WORD_BITS-1:0]       word_inverse;
    assign word = ~word_inverse;

    // the newest lane above those before it, which move down by one, and at last to the end
    wire [WORD_BITS-1:0]       next_word = WORD_BITS'({code, word}
        >> (coded_last[STAGES-1] ? CODE_BITS * (FILL + 1) : CODE_BITS));

    wire step      = !word_valid || word_ready;
    wire end_index = index == SLOT_BITS'(SLOTS - 1);
    wire end_lane  = lane == LANE_BITS'(LANES - 1) || end_index;

    assign draining   = (issuing || counted) && !(CONTRAST && encodes);
    assign drain      = step && issuing;
    assign drain_slot = index;

    always_ff @(posedge clk) begin
        if (start || rst || again) begin
            issuing <= 1'b1;
            encodes <= again && !rst;
            index   <= '0;
            lane    <= '0;
        end else if (step) begin
            if (issuing) begin
                index <= index + 1'b1;
                lane  <= end_lane ? '0 : lane + 1'b1;
            end
            if (end_index) issuing <= 1'b0;
        end
        if (step) begin
            counted        <= issuing;
            counted_word   <= issuing && end_lane;
            counted_last   <= end_index;
            coded          <= STAGES'({coded, counted && (encodes || !CONTRAST)});
            coded_word     <= STAGES'({coded_word, counted_word && (CONTRAST ? encodes : !clearing)});
            coded_last     <= STAGES'({coded_last, counted_last});
            if (coded[STAGES-1]) word_inverse <= ~next_word;
            word_valid     <= coded_word[STAGES-1];
            word_last      <= coded_last[STAGES-1];
        end
        if (counted && counted_last) clearing <= 1'b0;
        if (rst) begin
            clearing     <= 1'b1;
            counted      <= 1'b0;
            counted_word <= 1'b0;
            coded        <= '0;
            coded_word   <= '0;
            word_valid   <= 1'b0;
        end
    end

    generate
        if (OWN_MEAN) begin : g_own_mean
            logic                  deviates, deviating_last;
            logic [SLOT_BITS-1:0]  deviating_slot;
            logic [ENTRY_BITS+1:0] deviation;
            logic [CODE_BITS-1:0]  own_code;
            wire                   unused = &{
                1'b0, load[1], own_code, deviates, deviating_last, deviating_slot, deviation
            };

            vpr_own_mean #(.LOADABLE(LOADABLE)) own_mean (
                .clk(clk), .rst(rst), .load({load[2], load[0]}), .load_address(load_address),
                .load_word(load_word), .step(step), .clearing(clearing), .hold(paused),
                .valid(counted && !(CONTRAST && encodes)), .last(counted && counted_last && !(CONTRAST && encodes)),
                .slot(drained_slot), .count(drained), .code(own_code), .deviates(deviates),
                .deviating_last(deviating_last), .deviating_slot(deviating_slot),
                .deviation(deviation)
            );
            if (CONTRAST) begin : g_contrast
                vpr_contrast contrast (
                    .clk(clk), .rst(rst), .clear(start), .deviates(deviates),
                    .last(deviating_last), .deviating_slot(deviating_slot),
                    .deviation(deviation), .divided(again), .step(step), .slot(index),
                    .code(code)
                );
            end else begin : g_own_codes
                assign again = 1'b0;
                assign code  = own_code;
            end
        end else begin : g_table
            logic [INDEXED_BITS-1:0] entry;
            wire                     unused = &{1'b0, paused, load, drained_slot};
            assign again = 1'b0;
            vpr_rom #(
                .DEPTH(ENTRIES), .BITS(CODE_BITS), .ADDRESS_BITS(INDEXED_BITS),
                .FILE("codes.mem"), .LOADABLE(LOADABLE), .STYLE("block")
            ) codes (
                .clk(clk), .enable(step), .address(entry), .word(code),
                .load(load[0]), .load_address(load_address), .load_word(load_word)
            );
            if (TABLES > 1) begin : g_tables
                logic [TABLE_BITS-1:0] code_table;
                vpr_rom #(
                    .DEPTH(SLOTS), .BITS(TABLE_BITS), .ADDRESS_BITS(SLOT_BITS),
                    .FILE("code_tables.mem"), .LOADABLE(LOADABLE)
                ) code_tables (
                    .clk(clk), .enable(step), .address(drain_slot), .word(code_table),
                    .load(load[1]), .load_address(load_address), .load_word(load_word)
                );
                assign entry = INDEXED_BITS'(code_table) * INDEXED_BITS'(STRIDE)
                               + INDEXED_BITS'(drained);
            end else begin : g_one_table
                assign entry = INDEXED_BITS'(drained);
            end
        end
    endgenerate
endmodule
