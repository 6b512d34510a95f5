//! The temporary files of unfinished outputs, which an interrupt (Ctrl-C) takes away.

use std::fs;
use std::path::{Path, PathBuf};
use std::process;
use std::sync::{Mutex, PoisonError};

use crate::stderr;

/// What shells say of a program that SIGINT ended: 128 and its number.
const INTERRUPTED: i32 = 130;

static FILES: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Says that a file is going to be made.
pub(crate) fn add(path: &Path) {
    FILES.lock().unwrap_or_else(PoisonError::into_inner).push(path.into());
}

/// Says that it has its place now, or is gone.
pub(crate) fn forget(path: &Path) {
    FILES.lock().unwrap_or_else(PoisonError::into_inner).retain(|it| it != path);
}

/// From here on an interrupt removes the files and ends the program.
pub(crate) fn remove_on_interrupt() {
    let handler = || {
        // Held to the end, so that no file is made meanwhile.
        let files = FILES.lock().unwrap_or_else(PoisonError::into_inner);
        for path in files.iter() {
            // It may not be there yet, or no longer; what cannot be removed stays.
            let _ = fs::remove_file(path);
        }
        process::exit(INTERRUPTED);
    };
    match ctrlc::try_set_handler(handler) {
        // Whoever started the program has it ignore interrupts, as `nohup` and background jobs do.
        Ok(()) | Err(ctrlc::Error::MultipleHandlers) => {}
        Err(error) => {
            stderr::line(&format!("warning: an interrupt may leave temporary files: {error}"))
        }
    }
}
