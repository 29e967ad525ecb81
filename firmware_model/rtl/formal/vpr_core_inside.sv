
    // Properties of vpr_core that refer to signals inside it: put before its end by the proof's script.
    // A window ends only while the place filter is idle, so that none begins while it divides.
    logic was_reset = 1'b0;
    always_ff @(posedge clk_i) if (rst_i) was_reset <= 1'b1;
`ifdef PROVE_IDLE
    always_comb if (was_reset && !rst_i && window_end) assert (filter_idle);
`endif
