// Logarithm of a number in sixteenths of an octave, rounded down: floor(16 log2(n + 1)), of 9 bits
// and inverted. The number has up to 23 bits. It comes five times, with `valid_i`, from its lowest bit
// on, and behind it at least one bit of 0, into which a carry may go: n + 1 is made anew each time.
//
// In the first round (16, of the one-hot `round_i`) the highest 1 of n + 1 gives the whole octaves. The
// others (8, 4, 2, 1) decide on a bit of the fraction each: is n + 1, with its highest 1 at bit 23,
// above the power of two of what was decided and that bit? Powers are kept as floor(2^(23 + f/16)).
// They are no integers but for f = 0, so that n + 1 reaches one where it is above its floor, and so do
// the upper bits of both where n + 1 has fewer: bits below its lowest are left out.
//
// `decide_i` ends a round two clocks after its last bit or later, when `round_i` is the next one;
// behind the fifth it completes the logarithm, which stays until the first bit of the next number.
module vpr_logarithm (
    input  logic       clk_i,
    input  logic [4:0] round_i,
    input  logic       valid_i,
    input  logic       number_i,
    input  logic       decide_i,
    output logic [8:0] inverse_o
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

    logic [4:0] octaves_inverse_q;
    logic [3:0] fraction_inverse_q;
    // of the bit, and in the first round of the bit before, from 0 on; 32: above the highest 1
    logic [5:0] place_q;
    logic       carry_q;
    logic       bit_1_q, power_q;    // of n + 1, a clock later, and the power's
    logic       valid_q, finds_q;    // a clock later: of any round, and of the first
    logic       compares_q, above_q;

    wire bit_0 = number_i ^ carry_q;

    assign inverse_o = {octaves_inverse_q, fraction_inverse_q};

    always_ff @(posedge clk_i) begin
        power_q    <= memory[{fraction_inverse_q, place_q[4:0]}];
        bit_1_q    <= bit_0;
        valid_q    <= valid_i;
        finds_q    <= valid_i && round_i[4];
        compares_q <= valid_i && !place_q[5] && !round_i[4];
        carry_q    <= !valid_i || (number_i && carry_q);
        if (!valid_i) place_q <= round_i[4] ? '0 : {1'b0, octaves_inverse_q};
        else if (!place_q[5] && (valid_q || !round_i[4])) place_q <= place_q + 1'b1;
        if (finds_q && bit_1_q) octaves_inverse_q <= ~place_q[4:0];
        if (decide_i) above_q <= 1'b0;
        else if (compares_q && bit_1_q != power_q) above_q <= bit_1_q;
        // the bit of the ended round stays 1 if it is reached, and that of the next is tried
        if (decide_i)
            fraction_inverse_q <=
                (fraction_inverse_q | ({round_i[2:0], round_i[4]} & {4{!above_q}})) & ~round_i[3:0];
        if (valid_i && round_i[4]) fraction_inverse_q <= '1;
    end
endmodule
