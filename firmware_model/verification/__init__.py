"""What verifies the model, the firmware and the core: mutants, fuzzers, proofs. Not installed."""
