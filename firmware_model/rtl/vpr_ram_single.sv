// Memory with one port that writes or reads in a clock, as the large memories of small FPGAs have
// it. It starts undefined, but for a FILE; while it is written, its output keeps its value. STYLE is
// what yosys makes of it: "huge" is the SPRAM of an iCE40UP5K, "auto" its own choice.
module vpr_ram_single #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    // verilator lint_off UNUSEDPARAM
    parameter     STYLE        = "auto",
    // verilator lint_on UNUSEDPARAM
    parameter     FILE         = ""
) (
    input  logic                    clk_i,
    input  logic                    write_i,
    input  logic [ADDRESS_BITS-1:0] address_i,
    input  logic [BITS-1:0]         write_word_i,
    output logic [BITS-1:0]         read_word_o
);
    (* ram_style = STYLE *)
    logic [BITS-1:0] memory[0:DEPTH-1];

    generate
        if (FILE != "") begin : g_contents
            initial $readmemh(FILE, memory);
        end
    endgenerate

    always_ff @(posedge clk_i) begin
        if (write_i) memory[address_i] <= write_word_i;
        else read_word_o <= memory[address_i];
    end
endmodule
