"""What every room stands on: checks, memory, threads, progress, tables; knows no ensemble."""
