//! Micro-expressions, in a single test program so that the libraries are linked once.

mod extract;
mod loso;
mod opencv;
mod parity;
mod published_scores;
mod run;
