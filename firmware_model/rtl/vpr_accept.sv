// Acceptance in integers: by margin, second - best >= MARGIN; by ratio, second > 0 and
// best * DENOMINATOR <= second * NUMERATOR. Without a second best a match is not accepted.
//
// The answer is registered at the second clock edge after its inputs are there.
module vpr_accept #(
    localparam bit          BY_MARGIN    = vpr_pkg::BY_MARGIN,
    localparam logic [31:0] MARGIN       = vpr_pkg::MARGIN,
    localparam logic [15:0] NUMERATOR    = vpr_pkg::NUMERATOR,
    localparam logic [15:0] DENOMINATOR  = vpr_pkg::DENOMINATOR,
    localparam int          SUM_BITS     = vpr_pkg::SUM_BITS,
    localparam int          PRODUCT_BITS = vpr_pkg::PRODUCT_BITS
) (
    input  logic                clk_i,
    input  logic [SUM_BITS-1:0] best_sum_i,
    input  logic                has_second_i,
    input  logic [SUM_BITS-1:0] second_sum_i,
    output logic                accepted_o
);
    generate
        if (BY_MARGIN) begin : g_margin
            localparam int BITS = (SUM_BITS > 32 ? SUM_BITS : 32) + 1;
            logic [BITS-1:0] least_q;
            always_ff @(posedge clk_i) begin
                least_q    <= BITS'(best_sum_i) + BITS'(MARGIN);
                accepted_o <= has_second_i && least_q <= BITS'(second_sum_i);
            end
        end else begin : g_ratio
            // the best's inverted, as it is compared
            logic [PRODUCT_BITS-1:0] best_inverse_q, second_product_q;
            // the carry says that the second's is not less
            wire [PRODUCT_BITS+1:0] enough =
                {1'b0, second_product_q, 1'b1} + {1'b0, best_inverse_q, 1'b1};
            always_ff @(posedge clk_i) begin
                best_inverse_q   <= ~(PRODUCT_BITS'(best_sum_i) * PRODUCT_BITS'(DENOMINATOR));
                second_product_q <= PRODUCT_BITS'(second_sum_i) * PRODUCT_BITS'(NUMERATOR);
                accepted_o <= has_second_i && second_sum_i != 0 && enough[PRODUCT_BITS+1];
            end
            wire unused = &{1'b0, enough};
        end
    endgenerate
endmodule
