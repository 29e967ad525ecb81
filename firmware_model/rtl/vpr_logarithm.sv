// Logarithm of a number in sixteenths of an octave, rounded down: floor(16 log2(n + 1)), of 9 bits
// and inverted. The number has up to 23 bits. It comes five times, with `valid`, from its lowest bit
// on, and behind it at least one bit of 0, into which a carry may go: n + 1 is made anew each time.
//
// In the first round (16, of the one-hot `round`) the highest 1 of n + 1 gives the whole octaves. The
// others (8, 4, 2, 1) decide on a bit of the fraction each: is n + 1, with its highest 1 at bit 23,
// above the power of two of what was decided and that bit? Powers are kept as floor(2^(23 + f/16)).
// They are no integers but for f = 0, so that n + 1 reaches one where it is above its floor, and so do
// the upper bits of both where n + 1 has fewer: bits below its lowest are left out.
//
// `decide` ends a round two clocks after its last bit or later, when `round` is the next one; behind
// the fifth it completes the logarithm, which stays until the first bit of the next number.
module vpr_logarithm (
    input  logic       clk,
    input  logic [4:0] round,
    input  logic       valid,
    input  logic       number,
    input  logic       decide,
    output logic [8:0] inverse
);
    // floor(2^(23 + f/16)) of f = 15 to 0
    localparam logic [16*24-1:0] POWERS = {
        24'hF5257D, 24'hEAC0C6, 24'hE0CCDE, 24'hD744FC, 24'hCE248C, 24'hC5672A, 24'hBD08A3, 24'hB504F3,
        24'hAD583E, 24'hA5FED6, 24'h9EF532, 24'h9837F0, 24'h91C3D3, 24'h8B95C1, 24'h85AAC3, 24'h800000
    };

    // bits of all powers, the lowest at 8, as the address of the highest is then all ones
    (* ram_style = "block" *)
    logic memory[0:511];

    integer of, at;
    initial
        for (of = 0; of < 16; of = of + 1)
            for (at = 0; at < 32; at = at + 1)
                memory[(15 - of) * 32 + at] = at < 8 ? 1'b0 : POWERS[24*of+(at<8?0:at-8)];

    logic [4:0] octaves_inverse;
    logic [3:0] fraction_inverse;
    logic [5:0] place;           // of the bit; in the first round from 0 on; 32: above the highest 1
    logic       carry;
    logic       bit_1, power;    // of n + 1, a clock later, and the power's
    logic       compares, above;

    wire bit_0 = number ^ carry;

    assign inverse = {octaves_inverse, fraction_inverse};

    always_ff @(posedge clk) begin
        power    <= memory[{fraction_inverse, place[4:0]}];
        bit_1    <= bit_0;
        compares <= valid && !place[5] && !round[4];
        carry    <= !valid || (number && carry);
        if (!valid) place <= round[4] ? '0 : {1'b0, octaves_inverse};
        else if (!place[5]) place <= place + 1'b1;
        if (valid && round[4] && bit_0) octaves_inverse <= ~place[4:0];
        if (decide) above <= 1'b0;
        else if (compares && bit_1 != power) above <= bit_1;
        // the bit of the ended round stays 1 if it is reached, and that of the next is tried
        if (decide)
            fraction_inverse <=
                (fraction_inverse | ({round[2:0], round[4]} & {4{!above}})) & ~round[3:0];
        if (valid && round[4]) fraction_inverse <= '1;
    end
endmodule
