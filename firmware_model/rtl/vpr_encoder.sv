// Counts of the ended window to a descriptor: a slot a clock is read, cleared, encoded by its code
// table and packed, LANES codes a word, the first in the least significant bits. Lanes beyond the
// last slot are zero. The whole unit stands while a word is not taken. After reset it passes over
// all slots once, without a word, to clear them (`clearing`).
module vpr_encoder #(
    parameter int          SLOTS      = 1,
    parameter int          WORDS      = 1,
    parameter int          LANES      = 1,
    parameter int          TABLES     = 1,
    parameter int          COUNT_MAX  = 1,
    parameter int          SLOT_BITS  = 1,
    parameter int          COUNT_BITS = 1,
    parameter int          TABLE_BITS = 1,
    parameter int          CODE_BITS  = 1,
    parameter              CODES_FILE       = "codes.mem",
    parameter              CODE_TABLES_FILE = "code_tables.mem"
) (
    input  logic                       clk,
    input  logic                       rst,
    input  logic                       start,
    output logic                       clearing,
    output logic                       drain,
    output logic [SLOT_BITS-1:0]       drain_slot,
    input  logic [COUNT_BITS-1:0]      drained,
    output logic                       clear,
    output logic [SLOT_BITS-1:0]       clear_slot,
    output logic                       word_valid,
    input  logic                       word_ready,
    output logic                       word_last,
    output logic [LANES*CODE_BITS-1:0] word
);
    localparam int PADDED       = WORDS * LANES;
    localparam int INDEX_BITS   = $clog2(PADDED + 1);
    localparam int LANE_BITS    = LANES > 1 ? $clog2(LANES) : 1;
    localparam int STRIDE       = COUNT_MAX + 1;
    localparam int ENTRIES      = TABLES * STRIDE;
    localparam int ENTRY_BITS   = $clog2(ENTRIES);

    logic                  issuing;
    logic [INDEX_BITS-1:0] index;
    logic [LANE_BITS-1:0]  lane;

    // behind the counters, behind the code table
    logic                  counted, coded;
    logic                  counted_filler, coded_filler;
    logic                  counted_word, coded_word;
    logic                  counted_last, coded_last;
    logic [CODE_BITS-1:0]  code;
    logic [ENTRY_BITS-1:0] entry;

    wire step      = !word_valid || word_ready;
    wire end_lane  = lane == LANE_BITS'(LANES - 1);
    wire end_index = index == INDEX_BITS'(PADDED - 1);

    assign drain      = step;
    assign drain_slot = index[SLOT_BITS-1:0];
    assign clear      = counted && !counted_filler;

    always_ff @(posedge clk) begin
        if (start || rst) begin
            issuing <= 1'b1;
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
            counted_filler <= index >= INDEX_BITS'(SLOTS);
            counted_word   <= issuing && end_lane;
            counted_last   <= end_index;
            clear_slot     <= index[SLOT_BITS-1:0];
            coded          <= counted;
            coded_filler   <= counted_filler;
            coded_word     <= counted_word && !clearing;
            coded_last     <= counted_last;
            // the newest lane above those before it, which move down by one
            if (coded) word <= (LANES * CODE_BITS)'({newest, word} >> CODE_BITS);
            word_valid     <= coded_word;
            word_last      <= coded_last;
        end
        if (counted && counted_last) clearing <= 1'b0;
        if (rst) begin
            clearing     <= 1'b1;
            counted      <= 1'b0;
            counted_word <= 1'b0;
            coded        <= 1'b0;
            coded_word   <= 1'b0;
            word_valid   <= 1'b0;
        end
    end

    wire [CODE_BITS-1:0] newest = coded_filler ? CODE_BITS'(0) : code;

    generate
        if (TABLES > 1) begin : g_tables
            logic [TABLE_BITS-1:0] code_table;
            vpr_rom #(
                .DEPTH(SLOTS), .BITS(TABLE_BITS), .ADDRESS_BITS(SLOT_BITS), .FILE(CODE_TABLES_FILE)
            ) code_tables (
                .clk(clk), .enable(step), .address(drain_slot), .word(code_table)
            );
            assign entry = ENTRY_BITS'(code_table) * ENTRY_BITS'(STRIDE) + ENTRY_BITS'(drained);
        end else begin : g_one_table
            assign entry = ENTRY_BITS'(drained);
        end
    endgenerate

    vpr_rom #(
        .DEPTH(ENTRIES), .BITS(CODE_BITS), .ADDRESS_BITS(ENTRY_BITS), .FILE(CODES_FILE)
    ) codes (
        .clk(clk), .enable(step), .address(entry), .word(code)
    );
endmodule
