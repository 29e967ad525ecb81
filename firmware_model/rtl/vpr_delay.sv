// Delay line: `oldest` is the word that was pushed STEPS pushes ago. It stands until the next push,
// which may come with each clock; before STEPS pushes it has no meaning. From two steps on the words
// are a ring in a block memory, or in logic (IN_LOGIC).
module vpr_delay #(
    parameter int STEPS = 1,
    parameter int BITS  = 1,
    parameter bit IN_LOGIC = 0
) (
    input  logic            clk,
    input  logic            rst,
    input  logic            push,
    input  logic [BITS-1:0] word,
    output logic [BITS-1:0] oldest
);
    generate
        if (STEPS == 1) begin : g_register
            wire unused = rst;
            always_ff @(posedge clk) if (push) oldest <= word;
        end else begin : g_ring
            localparam int ADDRESS_BITS = $clog2(STEPS);

            // where the oldest is, and the next word goes
            logic [ADDRESS_BITS-1:0] at;
            wire [ADDRESS_BITS-1:0]  next =
                at == ADDRESS_BITS'(STEPS - 1) ? '0 : at + 1'b1;

            always_ff @(posedge clk) begin
                if (rst) at <= '0;
                else if (push) at <= next;
            end

            vpr_ram #(
                .DEPTH(STEPS), .BITS(BITS), .ADDRESS_BITS(ADDRESS_BITS),
                .IN_LOGIC(IN_LOGIC), .IN_BLOCK(!IN_LOGIC)
            ) words (
                .clk(clk), .write(push), .write_address(at), .write_word(word),
                .read(1'b1), .read_address(push ? next : at), .read_word(oldest)
            );
        end
    endgenerate
endmodule
