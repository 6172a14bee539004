//! Micro-expressions, in a single test program so that the libraries are linked once.

mod apex;
mod cache;
mod extract;
mod face;
mod features;
mod head_motion;
mod linear;
mod loso;
mod made_up;
mod metrics;
mod model;
mod opencv;
mod parity;
mod predictions;
mod protocol;
mod published_scores;
mod regions;
mod results;
mod run;
mod spotting;
mod spotting_events;
mod statistics;
mod strain;
mod summary;
mod time_course;
