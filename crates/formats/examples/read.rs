//! Reads a graph file, and says how long it took and how much memory the process needed at most.
//!
//!     cargo run --release -p evergraph-formats --example read -- FILE
#![allow(clippy::print_stdout, reason = "a program that measures says what it measured")]

use std::error::Error;
use std::time::Instant;

use evergraph_formats::{Document, ReadOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("give the path of a graph file")?;
    let size = std::fs::metadata(&path)?.len() as f64;
    let start = Instant::now();
    let document = Document::read(&path, &ReadOptions::default())?;
    let seconds = start.elapsed().as_secs_f64();
    println!("{} records in {seconds:.2} s, {:.1} MB", document.records().len(), size / 1e6);
    // Linux says how much was needed at most.
    if let Ok(status) = std::fs::read_to_string("/proc/self/status")
        && let Some(line) = status.lines().find(|line| line.starts_with("VmHWM"))
        && let Some(kilobytes) = line.split_whitespace().nth(1)
    {
        let peak = kilobytes.parse::<f64>()? * 1024.0;
        println!("peak memory {:.1} MB, {:.2} times the file", peak / 1e6, peak / size);
    }
    Ok(())
}
