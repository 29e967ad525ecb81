// Contrast codes: the deviations of a window from the running means of their counters, less their
// own mean over all slots, rounded to octaves, saturated, plus half the range.
//
// The deviations d come from vpr_running_mean, in the order of slots behind `clear_i`, the last with
// `last_i`: as d + 128 + 2^LEVEL_BITS, which is positive. They are kept, and added up. Their mean
// g = floor((2 sum d + S) / (2 S)) over S slots is floor((sum d + floor(S / 2)) / S): for an odd S the
// half that this leaves out cannot raise a sum of integers to a multiple of S. With S 2^LEVEL_BITS
// added it is positive, and below S 2^QUOTIENT_BITS, as |d| < 2^LEVEL_BITS: so its upper bits are
// less than S, and the quotient has QUOTIENT_BITS. Division is by restoring, a bit a clock, of the
// register that holds the sum; then it holds the quotient g + 2^LEVEL_BITS, inverted as it is
// subtracted, and `divided_o` is high for a clock. From then on the code of `slot_i` follows two steps
// later: both have the same 2^LEVEL_BITS, and the rounding is in the deviation.
module vpr_contrast #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int LEVEL_BITS = vpr_pkg::LEVEL_BITS,
    localparam int CODE_BITS  = vpr_pkg::CODE_BITS
) (
    input  logic                  clk_i,
    input  logic                  rst_i,
    input  logic                  clear_i,
    input  logic                  deviates_i,
    input  logic                  last_i,
    input  logic [SLOT_BITS-1:0]  deviating_slot_i,
    input  logic [LEVEL_BITS+1:0] deviation_i,
    output logic                  divided_o,
    input  logic                  step_i,
    input  logic [SLOT_BITS-1:0]  slot_i,
    output logic [CODE_BITS-1:0]  code_o
);
    localparam int LEVEL_FRACTION    = 8;  // fraction bits of a logarithm
    localparam int QUOTIENT_BITS = LEVEL_BITS + 1;
    localparam int REST_BITS     = SLOTS > 1 ? $clog2(SLOTS) : 1;
    localparam int TOTAL_BITS    = REST_BITS + QUOTIENT_BITS;
    localparam int LEFT_BITS     = $clog2(QUOTIENT_BITS);
    // without the rounding of the deviations, and with that of their mean
    localparam int BEGIN         = SLOTS / 2 - (SLOTS << (LEVEL_FRACTION - 1));
    localparam int EXCESS_BITS   = LEVEL_BITS + 3;
    localparam int WHOLE_BITS    = EXCESS_BITS - LEVEL_FRACTION;
    localparam int OCTAVE_BITS   = WHOLE_BITS > CODE_BITS + 1 ? WHOLE_BITS : CODE_BITS + 1;

    localparam logic [CODE_BITS-1:0] HALF = CODE_BITS'(1 << (CODE_BITS - 1));

    logic                     divides_q;
    logic [LEFT_BITS-1:0]     left_q;
    // the sum; then what is left of it above its bits to come, and behind these the quotient's
    logic [REST_BITS-1:0]     rest_q;
    logic [QUOTIENT_BITS-1:0] low_q;
    logic [LEVEL_BITS+1:0]    kept;

    wire [REST_BITS:0]   trial    = {rest_q, low_q[QUOTIENT_BITS-1]};
    wire [REST_BITS+1:0] lessened = {1'b0, trial} - (REST_BITS + 2)'(SLOTS);
    wire                 fits     = !lessened[REST_BITS+1];

    // the deviation less their mean, with a carry into the lowest bit
    wire [EXCESS_BITS:0] excess = {1'b0, kept, 1'b1} + {2'b11, low_q, 1'b1};
    logic signed [OCTAVE_BITS-1:0] octaves_q;
    // in range if the bits from the code's highest on are all as the sign
    wire   below  = octaves_q[OCTAVE_BITS-1];
    wire   beyond = octaves_q[OCTAVE_BITS-1:CODE_BITS-1] != {(OCTAVE_BITS - CODE_BITS + 1){below}};
    assign code_o   = beyond ? {CODE_BITS{!below}} : octaves_q[CODE_BITS-1:0] ^ HALF;

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(LEVEL_BITS + 2), .ADDRESS_BITS(SLOT_BITS)
    ) deviations (
        .clk_i(clk_i), .write_i(deviates_i), .write_address_i(deviating_slot_i),
        .write_word_i(deviation_i),
        .read_i(step_i), .read_address_i(slot_i), .read_word_o(kept)
    );

    always_ff @(posedge clk_i) begin
        divides_q <= (deviates_i && last_i) || (divides_q && left_q != 0);
        divided_o <= divides_q && left_q == 0;
        left_q    <= divides_q ? left_q - 1'b1 : LEFT_BITS'(QUOTIENT_BITS - 1);
        if (divides_q) begin
            rest_q <= fits ? lessened[REST_BITS-1:0] : trial[REST_BITS-1:0];
            low_q  <= {low_q[QUOTIENT_BITS-2:0], !fits};
        end else if (deviates_i) {rest_q, low_q} <= {rest_q, low_q} + TOTAL_BITS'(deviation_i);
        if (clear_i) {rest_q, low_q} <= TOTAL_BITS'(BEGIN);
        if (step_i) octaves_q <= OCTAVE_BITS'($signed(excess[EXCESS_BITS-:WHOLE_BITS]));
        if (rst_i) begin
            divides_q <= 1'b0;
            divided_o <= 1'b0;
        end
    end

    wire unused = &{1'b0, excess, lessened};
endmodule
