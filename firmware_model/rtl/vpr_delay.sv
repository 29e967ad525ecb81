// Delay line: `oldest_o` is the word that was pushed STEPS pushes ago. It stands until the next push,
// which may come with each clock; before STEPS pushes it has no meaning. From two steps on the words
// are a ring in a block memory, or in logic (IN_LOGIC).
module vpr_delay #(
    parameter int STEPS = 1,
    parameter int BITS  = 1,
    parameter bit IN_LOGIC = 0
) (
    input  logic            clk_i,
    input  logic            rst_i,
    input  logic            push_i,
    input  logic [BITS-1:0] word_i,
    output logic [BITS-1:0] oldest_o
);
    generate
        if (STEPS == 1) begin : g_register
            wire unused = rst_i;
            always_ff @(posedge clk_i) if (push_i) oldest_o <= word_i;
        end else begin : g_ring
            localparam int ADDRESS_BITS = $clog2(STEPS);

            // where the oldest is, and the next word goes
            logic [ADDRESS_BITS-1:0] at_q;
            wire [ADDRESS_BITS-1:0]  at_d =
                at_q == ADDRESS_BITS'(STEPS - 1) ? '0 : at_q + 1'b1;

            always_ff @(posedge clk_i) begin
                if (rst_i) at_q <= '0;
                else if (push_i) at_q <= at_d;
            end

            vpr_ram #(
                .DEPTH(STEPS), .BITS(BITS), .ADDRESS_BITS(ADDRESS_BITS),
                .IN_LOGIC(IN_LOGIC), .IN_BLOCK(!IN_LOGIC)
            ) words (
                .clk_i(clk_i), .write_i(push_i), .write_address_i(at_q), .write_word_i(word_i),
                .read_i(1'b1), .read_address_i(push_i ? at_d : at_q), .read_word_o(oldest_o)
            );
        end
    endgenerate
endmodule
