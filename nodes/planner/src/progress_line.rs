//! What a person sees while a plan is made: a line that changes on a terminal, else a plain line a stage.

use std::io::{IsTerminal, Write};
use std::time::Instant;

use patchmill_msgs::action::PlanSurfaceFeedback;

/// Shows feedback on stderr.
pub struct ProgressLine {
    terminal: bool,
    begin: Instant,
    stage: String,
}

impl ProgressLine {
    /// Starts the clock.
    pub fn new() -> Self {
        Self { terminal: std::io::stderr().is_terminal(), begin: Instant::now(), stage: String::new() }
    }

    /// Shows where the plan is.
    pub fn show(&mut self, feedback: &PlanSurfaceFeedback) {
        self.show_stage(&feedback.stage, &feedback.text, feedback.fraction);
    }

    /// Shows that a stage has done this share of its work.
    pub fn show_stage(&mut self, stage: &str, text: &str, fraction: f64) {
        let (seconds, percent) = (self.begin.elapsed().as_secs_f64(), fraction * 100.0);
        if self.terminal {
            eprint!("\r\x1b[K{seconds:6.1} s  {stage}: {text} {percent:.0} %");
            // A terminal that cannot be flushed shows the line later.
            let _ = std::io::stderr().flush();
        } else if stage != self.stage {
            eprintln!("{seconds:6.1} s  {stage}: {text}");
        }
        stage.clone_into(&mut self.stage);
    }

    /// Ends the changing line.
    pub fn end(&self) {
        if self.terminal && !self.stage.is_empty() {
            eprint!("\r\x1b[K");
        }
    }

    /// Since the start, s.
    pub fn seconds(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }
}

impl Default for ProgressLine {
    fn default() -> Self {
        Self::new()
    }
}
