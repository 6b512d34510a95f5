//! Tests that look into a live smoother.

mod solve;
