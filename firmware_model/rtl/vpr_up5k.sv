// Top for a board with an iCE40UP5K and a clock of 12 MHz, such as an iCEBreaker: the device at
// 48 MHz behind SPI. The places are in SPRAM.
module vpr_up5k (
    input  logic clk_12mhz,
    input  logic sck,
    input  logic ss_n,
    input  logic mosi,
    output logic miso,
    output logic ready,
    output logic match
);
    logic clk, locked;
    SB_PLL40_PAD #(
        .FEEDBACK_PATH("SIMPLE"), .DIVR(4'd0), .DIVF(7'd63), .DIVQ(3'd4), .FILTER_RANGE(3'd1)
    ) pll (
        .PACKAGEPIN(clk_12mhz), .PLLOUTGLOBAL(clk), .LOCK(locked), .RESETB(1'b1), .BYPASS(1'b0)
    );

    vpr_spi_device #(
        .MEMORY_STYLE("huge")
    ) device (
        .clk_i(clk), .locked_i(locked), .sck_i(sck), .ss_n_i(ss_n), .mosi_i(mosi), .miso_o(miso),
        .ready_o(ready), .match_o(match)
    );
endmodule
