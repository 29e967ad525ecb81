// vpr_delay as a shift register, whose words the properties of vpr_search refer to. That the ring in
// a memory does the same is a claim of its own: vpr_delay_properties.
module vpr_delay #(
    parameter STEPS    = 1,
    parameter BITS     = 1,
    parameter IN_LOGIC = 0
) (
    input  logic            clk_i,
    input  logic            rst_i,
    input  logic            push_i,
    input  logic [BITS-1:0] word_i,
    output logic [BITS-1:0] oldest_o
);
    logic [STEPS*BITS-1:0] delayed_q;  // the newest in the least significant bits

    always_ff @(posedge clk_i) if (push_i) delayed_q <= {delayed_q, word_i};

    assign oldest_o = delayed_q[(STEPS-1)*BITS+:BITS];
endmodule
