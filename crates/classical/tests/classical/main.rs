//! Farneback and TV-L1. The choice of an instruction set holds for a whole process: it has a test program of its own.

mod opencv;
mod properties;
