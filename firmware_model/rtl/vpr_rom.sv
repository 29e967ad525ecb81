// Read-only memory with a registered output. Its contents come from a file for $readmemh.
module vpr_rom #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    parameter     FILE         = ""
) (
    input  logic                    clk,
    input  logic                    enable,
    input  logic [ADDRESS_BITS-1:0] address,
    output logic [BITS-1:0]         word
);
    logic [BITS-1:0] memory[0:DEPTH-1];

    generate
        if (FILE != "") begin : g_contents
            initial $readmemh(FILE, memory);
        end
    endgenerate

    always_ff @(posedge clk) if (enable) word <= memory[address];
endmodule
