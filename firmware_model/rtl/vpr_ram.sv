// Memory with one write port and one read port with a registered output. It starts undefined.
// No unit reads what it writes in the same clock: nothing is promised for it. IN_LOGIC keeps it out of
// block memories, IN_BLOCK in them, however small it is.
module vpr_ram #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    parameter bit IN_LOGIC     = 0,
    parameter bit IN_BLOCK     = 0
) (
    input  logic                    clk_i,
    input  logic                    write_i,
    input  logic [ADDRESS_BITS-1:0] write_address_i,
    input  logic [BITS-1:0]         write_word_i,
    input  logic                    read_i,
    input  logic [ADDRESS_BITS-1:0] read_address_i,
    output logic [BITS-1:0]         read_word_o
);
    generate
        if (IN_LOGIC) begin : g_logic
            (* ram_style = "distributed" *)
            logic [BITS-1:0] memory[0:DEPTH-1];
            always_ff @(posedge clk_i) begin
                if (write_i) memory[write_address_i] <= write_word_i;
                if (read_i) read_word_o <= memory[read_address_i];
            end
        end else if (IN_BLOCK) begin : g_block
            (* ram_style = "block", no_rw_check *)
            logic [BITS-1:0] memory[0:DEPTH-1];
            always_ff @(posedge clk_i) begin
                if (write_i) memory[write_address_i] <= write_word_i;
                if (read_i) read_word_o <= memory[read_address_i];
            end
        end else begin : g_auto
            (* no_rw_check *)
            logic [BITS-1:0] memory[0:DEPTH-1];
            always_ff @(posedge clk_i) begin
                if (write_i) memory[write_address_i] <= write_word_i;
                if (read_i) read_word_o <= memory[read_address_i];
            end
        end
    endgenerate
endmodule
