// Codes of contrast: the deviations of a window from the running means of their counters, less their
// own mean over all slots, rounded to octaves, saturated, plus half the range.
//
// The deviations d come from vpr_own_mean, in the order of slots behind `clear`, the last with
// `last`: as d + 128 + 2^ENTRY_BITS, which is positive. They are kept, and added up. Their mean
// g = floor((2 sum d + S) / (2 S)) over S slots is floor((sum d + floor(S / 2)) / S): for an odd S the
// half that this leaves out cannot raise a sum of integers to a multiple of S. With S 2^ENTRY_BITS
// added it is positive, and below S 2^QUOTIENT_BITS, as |d| < 2^ENTRY_BITS: so its upper bits are
// less than S, and the quotient has QUOTIENT_BITS. Division is by restoring, a bit a clock, of the
// register that holds the sum; then it holds the quotient g + 2^ENTRY_BITS, inverted as it is
// subtracted, and `divided` is high for a clock. From then on the code of `slot` follows two steps
// later: both have the same 2^ENTRY_BITS, and the rounding is in the deviation.
module vpr_contrast #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int ENTRY_BITS = vpr_pkg::ENTRY_BITS,
    localparam int CODE_BITS  = vpr_pkg::CODE_BITS
) (
    input  logic                  clk,
    input  logic                  rst,
    input  logic                  clear,
    input  logic                  deviates,
    input  logic                  last,
    input  logic [SLOT_BITS-1:0]  deviating_slot,
    input  logic [ENTRY_BITS+1:0] deviation,
    output logic                  divided,
    input  logic                  step,
    input  logic [SLOT_BITS-1:0]  slot,
    output logic [CODE_BITS-1:0]  code
);
    localparam int LEVEL_BITS    = 8;  // fraction bits of a logarithm
    localparam int QUOTIENT_BITS = ENTRY_BITS + 1;
    localparam int REST_BITS     = SLOTS > 1 ? $clog2(SLOTS) : 1;
    localparam int TOTAL_BITS    = REST_BITS + QUOTIENT_BITS;
    localparam int LEFT_BITS     = $clog2(QUOTIENT_BITS);
    // without the rounding of the deviations, and with that of their mean
    localparam int BEGIN         = SLOTS / 2 - (SLOTS << (LEVEL_BITS - 1));
    localparam int EXCESS_BITS   = ENTRY_BITS + 3;
    localparam int WHOLE_BITS    = EXCESS_BITS - LEVEL_BITS;
    localparam int OCTAVE_BITS   = WHOLE_BITS > CODE_BITS + 1 ? WHOLE_BITS : CODE_BITS + 1;

    localparam logic [CODE_BITS-1:0] HALF = CODE_BITS'(1 << (CODE_BITS - 1));

    logic                     divides;
    logic [LEFT_BITS-1:0]     left;
    // the sum; then what is left of it above its bits to come, and behind these the quotient's
    logic [REST_BITS-1:0]     rest;
    logic [QUOTIENT_BITS-1:0] low;
    logic [ENTRY_BITS+1:0]    kept;

    wire [REST_BITS:0]   trial    = {rest, low[QUOTIENT_BITS-1]};
    wire [REST_BITS+1:0] lessened = {1'b0, trial} - (REST_BITS + 2)'(SLOTS);
    wire                 fits     = !lessened[REST_BITS+1];

    // the deviation less their mean, with a carry into the lowest bit
    wire [EXCESS_BITS:0] excess = {1'b0, kept, 1'b1} + {2'b11, low, 1'b1};
    logic signed [OCTAVE_BITS-1:0] octaves;
    // in range if the bits from the code's highest on are all as the sign
    wire   below  = octaves[OCTAVE_BITS-1];
    wire   beyond = octaves[OCTAVE_BITS-1:CODE_BITS-1] != {(OCTAVE_BITS - CODE_BITS + 1){below}};
    assign code   = beyond ? {CODE_BITS{!below}} : octaves[CODE_BITS-1:0] ^ HALF;

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(ENTRY_BITS + 2), .ADDRESS_BITS(SLOT_BITS)
    ) deviations (
        .clk(clk), .write(deviates), .write_address(deviating_slot), .write_word(deviation),
        .read(step), .read_address(slot), .read_word(kept)
    );

    always_ff @(posedge clk) begin
        divides <= (deviates && last) || (divides && left != 0);
        divided <= divides && left == 0;
        left    <= divides ? left - 1'b1 : LEFT_BITS'(QUOTIENT_BITS - 1);
        if (divides) begin
            rest <= fits ? lessened[REST_BITS-1:0] : trial[REST_BITS-1:0];
            low  <= {low[QUOTIENT_BITS-2:0], !fits};
        end else if (deviates) {rest, low} <= {rest, low} + TOTAL_BITS'(deviation);
        if (clear) {rest, low} <= TOTAL_BITS'(BEGIN);
        if (step) octaves <= OCTAVE_BITS'($signed(excess[EXCESS_BITS-:WHOLE_BITS]));
        if (rst) begin
            divides <= 1'b0;
            divided <= 1'b0;
        end
    end

    wire unused = &{1'b0, excess, lessened};
endmodule
