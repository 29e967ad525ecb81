// vpr_delay as a shift register, whose words the properties of vpr_search refer to. That the ring in
// a memory does the same is a claim of its own: vpr_delay_properties.
module vpr_delay #(
    parameter STEPS    = 1,
    parameter BITS     = 1,
    parameter IN_LOGIC = 0
) (
    input  logic            clk,
    input  logic            rst,
    input  logic            push,
    input  logic [BITS-1:0] word,
    output logic [BITS-1:0] oldest
);
    logic [STEPS*BITS-1:0] delayed;  // the newest in the least significant bits

    always_ff @(posedge clk) if (push) delayed <= {delayed, word};

    assign oldest = delayed[(STEPS-1)*BITS+:BITS];
endmodule
