// Registers of vpr_axi_lite; vpr_registers.h has the same for C, and says what they are.
package vpr_registers;
    localparam logic [7:0] ID               = 8'h00;
    localparam logic [7:0] DESIGN           = 8'h04;
    localparam logic [7:0] CONTROL          = 8'h08;
    localparam logic [7:0] STATUS           = 8'h0c;
    localparam logic [7:0] START            = 8'h10;
    localparam logic [7:0] START_HIGH       = 8'h14;
    localparam logic [7:0] ACTIVITY         = 8'h18;
    localparam logic [7:0] EVENT_TIME       = 8'h20;
    localparam logic [7:0] EVENT_TIME_HIGH  = 8'h24;
    localparam logic [7:0] EVENT_PIXEL      = 8'h28;
    localparam logic [7:0] PLACE            = 8'h30;
    localparam logic [7:0] TABLE_ADDRESS    = 8'h34;
    localparam logic [7:0] TABLE_WORD       = 8'h38;
    localparam logic [7:0] MATCH_WINDOW     = 8'h40;
    localparam logic [7:0] MATCH_PLACE      = 8'h44;
    localparam logic [7:0] MATCH_SUM        = 8'h48;
    localparam logic [7:0] MATCH_SECOND     = 8'h4c;
    localparam logic [7:0] MATCH_SECOND_SUM = 8'h50;
    localparam logic [7:0] MATCH_TIES       = 8'h54;
    localparam logic [7:0] MATCH_ACCEPTED   = 8'h58;
    localparam logic [7:0] MATCH_TRUST      = 8'h5c;
    localparam logic [7:0] MATCH_TAKE       = 8'h60;

    localparam logic [31:0] ID_VALUE = 32'h56505231;  // "VPR1"
endpackage
