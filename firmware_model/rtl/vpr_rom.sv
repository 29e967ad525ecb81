// Table with a registered output. Its contents come from a file for $readmemh, or are written before
// they are read (LOADABLE), a word of the least significant bits of `load_word` at a time.
module vpr_rom #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    parameter     FILE         = "",
    parameter bit LOADABLE     = 0,
    // verilator lint_off UNUSEDPARAM
    parameter     STYLE        = "auto"  // "block": in a block memory, however small
    // verilator lint_on UNUSEDPARAM
) (
    input  logic                    clk,
    input  logic                    enable,
    input  logic [ADDRESS_BITS-1:0] address,
    output logic [BITS-1:0]         word,
    input  logic                    load,
    input  logic [19:0]             load_address,
    input  logic [31:0]             load_word
);
    (* ram_style = STYLE *)
    logic [BITS-1:0] memory[0:DEPTH-1];

    generate
        if (LOADABLE) begin : g_loaded
            always_ff @(posedge clk)
                if (load) memory[load_address[ADDRESS_BITS-1:0]] <= load_word[BITS-1:0];
        end else if (FILE != "") begin : g_contents
            initial $readmemh(FILE, memory);
        end
    endgenerate

    always_ff @(posedge clk) if (enable) word <= memory[address];

    wire unused = &{1'b0, load, load_address, load_word};
endmodule
