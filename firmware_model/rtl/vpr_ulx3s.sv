// Top for a board with an ECP5 and a clock of 25 MHz, such as a ULX3S: the device at 100 MHz behind
// SPI.
module vpr_ulx3s (
    input  logic clk_25mhz,
    input  logic sck,
    input  logic ss_n,
    input  logic mosi,
    output logic miso,
    output logic ready,
    output logic match
);
    logic clk, locked;
    EHXPLLL #(
        .CLKI_DIV(1), .CLKFB_DIV(4), .CLKOP_DIV(6), .CLKOP_CPHASE(2), .CLKOP_FPHASE(0),
        .FEEDBK_PATH("CLKOP"), .CLKOP_ENABLE("ENABLED"), .PLLRST_ENA("DISABLED"),
        .INTFB_WAKE("DISABLED"), .STDBY_ENABLE("DISABLED"), .DPHASE_SOURCE("DISABLED"),
        .OUTDIVIDER_MUXA("DIVA"), .OUTDIVIDER_MUXB("DIVB"), .OUTDIVIDER_MUXC("DIVC"),
        .OUTDIVIDER_MUXD("DIVD")
    ) pll (
        .CLKI(clk_25mhz), .CLKFB(clk), .CLKOP(clk), .LOCK(locked), .RST(1'b0), .STDBY(1'b0),
        .PHASESEL0(1'b0), .PHASESEL1(1'b0), .PHASEDIR(1'b1), .PHASESTEP(1'b1),
        .PHASELOADREG(1'b1), .PLLWAKESYNC(1'b0), .ENCLKOP(1'b0)
    );

    vpr_spi_device #(
        .MEMORY_STYLE("auto"), .SLOW_BLOCKS(1)
    ) device (
        .clk_i(clk), .locked_i(locked), .sck_i(sck), .ss_n_i(ss_n), .mosi_i(mosi), .miso_o(miso),
        .ready_o(ready), .match_o(match)
    );
endmodule
