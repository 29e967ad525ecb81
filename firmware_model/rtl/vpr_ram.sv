// Memory with one write port and one read port with a registered output. It starts undefined.
// No unit reads what it writes in the same clock: nothing is promised for it.
module vpr_ram #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1
) (
    input  logic                    clk,
    input  logic                    write,
    input  logic [ADDRESS_BITS-1:0] write_address,
    input  logic [BITS-1:0]         write_word,
    input  logic                    read,
    input  logic [ADDRESS_BITS-1:0] read_address,
    output logic [BITS-1:0]         read_word
);
    (* no_rw_check *)
    logic [BITS-1:0] memory[0:DEPTH-1];

    always_ff @(posedge clk) begin
        if (write) memory[write_address] <= write_word;
        if (read) read_word <= memory[read_address];
    end
endmodule
