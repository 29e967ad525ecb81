// Replays a case over AXI4-Lite, tables and places included, and writes its matches as records. Runs
// in the folder of the case, as vpr_bench does: +case=NAME +results=FILE +seed=N +stall=PER_CENT
`timescale 1ns / 1ps
module vpr_axi_bench;
    import vpr_pkg::*;


    logic        aclk = 1'b0, aresetn = 1'b0;
    logic        s_axi_awvalid = 1'b0, s_axi_wvalid = 1'b0, s_axi_bready = 1'b0;
    logic        s_axi_arvalid = 1'b0, s_axi_rready = 1'b0;
    logic        s_axi_awready, s_axi_wready, s_axi_bvalid, s_axi_arready, s_axi_rvalid;
    logic [7:0]  s_axi_awaddr, s_axi_araddr;
    logic [31:0] s_axi_wdata, s_axi_rdata;
    logic [1:0]  s_axi_bresp, s_axi_rresp;
    logic        s_event_tready, match_waits;
    wire         s_event_tvalid = 1'b0;
    wire [EVENT_BITS-1:0] s_event_tdata = 'x;

    vpr_axi_lite bus (.match_waits_o(match_waits), .*);

    always #10 aclk = !aclk;

    string  case_name, results;
    integer seed, stall, file, out, idle, scanned, at;

    task automatic wait_at_random;
        while ($unsigned($random(seed)) % 100 < stall) @(negedge aclk);
    endtask

    // address and data come in either order; the answer is taken late
    logic [1:0] response;
    task automatic write(input logic [7:0] address, input logic [31:0] value);
        begin
            if ($random(seed) & 1) begin
                s_axi_awvalid = 1'b1;
                s_axi_awaddr  = address;
            end else begin
                s_axi_wvalid = 1'b1;
                s_axi_wdata  = value;
            end
            wait_at_random;
            s_axi_awvalid = 1'b1;
            s_axi_awaddr  = address;
            s_axi_wvalid  = 1'b1;
            s_axi_wdata   = value;
            while (!(s_axi_awready && s_axi_wready)) @(negedge aclk);
            @(negedge aclk);
            s_axi_awvalid = 1'b0;
            s_axi_wvalid  = 1'b0;
            s_axi_awaddr  = 'x;
            s_axi_wdata   = 'x;
            wait_at_random;
            s_axi_bready  = 1'b1;
            while (!s_axi_bvalid) @(negedge aclk);
            response = s_axi_bresp;
            @(negedge aclk);
            s_axi_bready  = 1'b0;
            if (response === 2'bxx) $fatal(1, "an answer is undefined");
        end
    endtask

    task automatic give(input logic [7:0] address, input logic [31:0] value);
        begin
            write(address, value);
            if (response != 2'b00) $display("the write to %0h is refused", address);
        end
    endtask

    logic [31:0] got;
    task automatic read(input logic [7:0] address);
        begin
            s_axi_arvalid = 1'b1;
            s_axi_araddr  = address;
            while (!s_axi_arready) @(negedge aclk);
            @(negedge aclk);
            s_axi_arvalid = 1'b0;
            s_axi_araddr  = 'x;
            wait_at_random;
            s_axi_rready  = 1'b1;
            while (!s_axi_rvalid) @(negedge aclk);
            got = s_axi_rdata;
            if (^got === 1'bx || s_axi_rresp !== 2'b00) $display("register %0h is undefined", address);
            @(negedge aclk);
            s_axi_rready  = 1'b0;
        end
    endtask

    logic [2047:0] word;
    task automatic load(input string name, input integer table_number);
        begin
            file = $fopen(name, "r");
            if (file == 0) $fatal(1, "a table cannot be opened");
            give(vpr_registers::TABLE_ADDRESS, table_number << 24);
            while ($fscanf(file, "%h", word) == 1) give(vpr_registers::TABLE_WORD, word[31:0]);
            $fclose(file);
        end
    endtask

    task automatic value_of(input string name);
        begin
            file = $fopen(name, "r");
            if (file == 0 || $fscanf(file, "%h", word) != 1) $fatal(1, "a file cannot be read");
            $fclose(file);
        end
    endtask

    task automatic read_match;
        begin
            $fwrite(out, "match");
            for (at = vpr_registers::MATCH_WINDOW; at < vpr_registers::MATCH_TRUST; at = at + 4) begin
                read(at[7:0]);
                $fwrite(out, ",%0d", $signed(got));
            end
            read(vpr_registers::MATCH_TRUST);
            if (FILTER) $fwrite(out, ",%0d\n", got);
            else $fwrite(out, "\n");
            give(vpr_registers::MATCH_TAKE, 1);
        end
    endtask

    initial begin
        if (!$value$plusargs("case=%s", case_name)) case_name = "case";
        if (!$value$plusargs("results=%s", results)) results = "results.csv";
        if (!$value$plusargs("seed=%d", seed)) seed = 1;
        if (!$value$plusargs("stall=%d", stall)) stall = 0;
        out = $fopen(results, "w");
        $fwrite(out, "case,%0s\n", case_name);
        repeat (3) @(negedge aclk);
        aresetn = 1'b1;
        read(vpr_registers::ID);
        if (got !== vpr_registers::ID_VALUE) $display("another device");
        load("displacement.mem", 0);
        load("lookup.mem", 1);
        if (CONTRAST) load("levels.mem", 2);
        if (CONTRAST) load("means.mem", 3);
        if (FILTER) load("place_activity.mem", 4);
        if (CONTRAST) load("limits.mem", 5);
        if (FILTER) load("place_bias.mem", 6);
        value_of("start.mem");
        give(vpr_registers::START, word[31:0]);
        if (TIMESTAMP_BITS > 32) give(vpr_registers::START_HIGH, word[63:32]);
        if (PAUSES) begin
            value_of("activity.mem");
            give(vpr_registers::ACTIVITY, word[31:0]);
        end
        give(vpr_registers::CONTROL, 1);
        file = $fopen("places.mem", "r");
        while ($fscanf(file, "%h", word) == 1)
            for (at = 0; at < WORD_BITS; at = at + 32) begin
                got = '0;
                while (!got[0]) read(vpr_registers::STATUS);
                give(vpr_registers::PLACE, word[at+:32]);
            end
        $fclose(file);
        file = $fopen("events.mem", "r");
        while ($fscanf(file, "%h", word) == 1) begin
            give(vpr_registers::EVENT_TIME, word[31:0]);
            if (EVENT_TIME_BITS > 32) give(vpr_registers::EVENT_TIME_HIGH, word[63:32]);
            got = '0;
            while (!got[1]) begin
                read(vpr_registers::STATUS);
                if (got[2]) begin
                    read_match;
                    got = '0;
                end
            end
            give(vpr_registers::EVENT_PIXEL, word[EVENT_TIME_BITS+:32]);
        end
        $fclose(file);
        idle = 0;
        while (idle < MATCH_CLOCKS) begin
            if (match_waits) begin
                read_match;
                idle = 0;
            end
            @(negedge aclk) idle = idle + 1;
        end
        write(vpr_registers::MATCH_TAKE, 1);
        if (response !== 2'b10) $display("a match that there is not was taken");
        write(8'hF0, 1);
        if (response !== 2'b10) $display("a register that there is not was written");
        $fclose(out);
        $finish;
    end
endmodule
