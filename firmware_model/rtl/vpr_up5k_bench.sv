// Replays a case through the SPI of the board's top, and writes its matches as records. Runs in the
// folder of the case, as vpr_bench does: +case=NAME +results=FILE
`timescale 1ns / 1ps

// The clock as the board has it behind the multiplier
module SB_PLL40_PAD #(
    parameter FEEDBACK_PATH = "",
    parameter DIVR = 0,
    parameter DIVF = 0,
    parameter DIVQ = 0,
    parameter FILTER_RANGE = 0
) (
    input  logic PACKAGEPIN,
    output logic PLLOUTGLOBAL,
    output logic LOCK,
    input  logic RESETB,
    input  logic BYPASS
);
    assign PLLOUTGLOBAL = PACKAGEPIN;
    initial begin
        LOCK = 1'b0;
        #200 LOCK = 1'b1;
    end
endmodule

module vpr_up5k_bench;
    import vpr_pkg::*;

    localparam int PLACE_BYTES = (LANES * CODE_BITS + 7) / 8;
    localparam int TIME_BYTES  = (TIMESTAMP_BITS + 7) / 8;
    localparam int START_BYTES = TIME_BYTES + (PAUSES ? 4 : 0);
    localparam int MATCH_BYTES = (MATCH_BITS + 7) / 8;

    logic clk = 1'b0, sck = 1'b0, ss_n = 1'b1, mosi = 1'b0;
    logic miso, ready, match;
    always #10 clk = !clk;

    vpr_up5k board (
        .clk_12mhz(clk), .sck(sck), .ss_n(ss_n), .mosi(mosi), .miso(miso), .ready(ready),
        .match(match)
    );

    // a byte in both directions, at a sixth of the clock's frequency
    logic [7:0] answer;
    task automatic exchange(input logic [7:0] sent);
        integer i;
        for (i = 7; i >= 0; i = i - 1) begin
            mosi = sent[i];
            #60 answer[i] = miso;
            sck = 1'b1;
            #60 sck = 1'b0;
        end
    endtask

    task automatic send(input logic [7:0] command, input logic [127:0] value, input integer bytes);
        integer i;
        begin
            ss_n = 1'b0;
            #120 exchange(command);
            for (i = 0; i < bytes; i = i + 1) exchange(value[8*i+:8]);
            #120 ss_n = 1'b1;
            #240;
        end
    endtask

    logic [8*MATCH_BYTES-1:0] bytes_read;
    logic                     accepted, has_second;
    logic [PLACE_BITS-1:0]    best, second, ties;
    logic [SUM_BITS-1:0]      best_sum, second_sum;
    logic [TRUST_BITS-1:0]    trust;
    logic [31:0]              window;
    assign {trust, accepted, ties, second_sum, second, has_second, best_sum, best, window} =
        (MATCH_BITS + TRUST_BITS)'(bytes_read[MATCH_BITS-1:0]);

    task automatic read_match;
        integer i;
        begin
            ss_n = 1'b0;
            #120 exchange(8'h04);
            if (answer[1] !== 1'b1) $display("the status has no match");
            if (answer[7] !== 1'b0) $display("something is lost");
            for (i = 0; i < MATCH_BYTES; i = i + 1) begin
                exchange(8'h00);
                bytes_read[8*i+:8] = answer;
            end
            #120 ss_n = 1'b1;
            if (has_second)
                $fwrite(out, "match,%0d,%0d,%0d,%0d,%0d,%0d,%0d", window, best, best_sum,
                        second, second_sum, ties, accepted);
            else
                $fwrite(out, "match,%0d,%0d,%0d,-1,-1,%0d,%0d", window, best, best_sum, ties,
                        accepted);
            if (FILTER) $fwrite(out, ",%0d\n", trust);
            else $fwrite(out, "\n");
            #240;
        end
    endtask

    string        case_name, results;
    integer       file, out, waited;
    logic [127:0] value, activity;
    initial begin
        if (!$value$plusargs("case=%s", case_name)) case_name = "case";
        if (!$value$plusargs("results=%s", results)) results = "results.csv";
        out = $fopen(results, "w");
        $fwrite(out, "case,%0s\n", case_name);
        #1000;
        file = $fopen("start.mem", "r");
        if ($fscanf(file, "%h", value) != 1) $fatal(1, "start.mem");
        $fclose(file);
        if (PAUSES) begin
            file = $fopen("activity.mem", "r");
            if ($fscanf(file, "%h", activity) != 1) $fatal(1, "activity.mem");
            $fclose(file);
            value = value | (activity << (8 * TIME_BYTES));
        end
        send(8'h03, value, START_BYTES);
        file = $fopen("places.mem", "r");
        while ($fscanf(file, "%h", value) == 1) send(8'h02, value, PLACE_BYTES);
        $fclose(file);
        file = $fopen("events.mem", "r");
        #20000;
        while ($fscanf(file, "%h", value) == 1) begin
            while (!ready) if (match) read_match; else #20;
            send(8'h01, value, EVENT_BITS / 8);
        end
        $fclose(file);
        waited = 0;
        while (waited < MATCH_CLOCKS) begin
            if (match) begin
                read_match;
                waited = 0;
            end
            #20 waited = waited + 1;
        end
        $fclose(out);
        $finish;
    end
endmodule
