//! What a person sees while something takes its time: a bar with rate and time left on a terminal, from the first second on; elsewhere
//! nothing; where asked for, a plain line a stage instead.

use std::fmt::Write;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use patchmill_msgs::action::PlanSurfaceFeedback;
use patchmill_node_runtime::topics::nodes;
use patchmill_node_runtime::{printable, say_on_stderr};

/// What is over sooner shows no bar.
const AT_ONCE: Duration = Duration::from_secs(1);
/// The clock of the bar moves on so often.
const TICK: Duration = Duration::from_millis(250);
/// Steps of the bar.
const STEPS: f64 = 10_000.0;

/// Shares of the stages in the time of a plan, the means of tests/fixtures/surface_1.json and surface_4.stl (`--verbose` tells), which are
/// up to 0.12 away: what is left is an estimate, no more.
const SHARES: [(&str, f64); 5] = [
    (nodes::SURFACE_INGESTION, 0.02),
    (nodes::ROLLING_BALL_ANALYSIS, 0.02),
    (nodes::SURFACE_PARTITIONING, 0.36),
    (nodes::PATH_GENERATION, 0.55),
    (nodes::MACHINE_INTERFACE, 0.05),
];

/// Shows progress on stderr.
pub struct ProgressLine {
    bar: ProgressBar,
    /// Whether there is a line a stage instead of a bar.
    verbose: bool,
    begin: Instant,
    stage: String,
    /// Which part of the whole is in work: its begin and its width.
    part: [f64; 2],
    /// Stages that take no part.
    skipped: f64,
}

impl ProgressLine {
    /// Starts the clock.
    pub fn new(verbose: bool) -> Self {
        let bar = ProgressBar::with_draw_target(Some(STEPS as u64), ProgressDrawTarget::hidden());
        bar.set_style(style());
        Self { bar, verbose, begin: Instant::now(), stage: String::new(), part: [0.0, 1.0], skipped: 0.0 }
    }

    /// What is shown from now on is part `index` of `count` equal ones.
    pub fn set_part(&mut self, index: usize, count: usize) {
        self.part = [index as f64 / count as f64, 1.0 / count as f64];
        self.stage.clear();
    }

    /// Only these stages work.
    pub fn set_stages(&mut self, stages: &[&str]) {
        let skipped = SHARES.iter().filter(|(stage, _)| !stages.contains(stage));
        self.skipped = skipped.map(|(_, share)| share).sum();
    }

    /// Shows where the plan is.
    pub fn show(&mut self, feedback: &PlanSurfaceFeedback) {
        self.show_stage(&feedback.stage, &feedback.text, feedback.fraction);
    }

    /// Shows that a stage has done this share of its work.
    pub fn show_stage(&mut self, stage: &str, text: &str, fraction: f64) {
        let whole = self.part[0] + self.part[1] * whole(stage, fraction, self.skipped);
        // The log of nodes would tear a bar.
        let bar = std::io::stderr().is_terminal() && !self.verbose;
        if bar && self.bar.is_hidden() && self.begin.elapsed() >= AT_ONCE {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            self.bar.enable_steady_tick(TICK);
        }
        // A stage that begins while the one before it still works does not take the bar back.
        self.bar.set_position(self.bar.position().max((whole * STEPS) as u64));
        let text = printable(text);
        self.bar.set_message(text.clone().into_owned());
        if stage != self.stage && self.verbose {
            say_on_stderr(format_args!("{:6.1} s  {stage}: {text}", self.seconds()));
        }
        stage.clone_into(&mut self.stage);
    }

    /// Says something that stays, bar or not.
    pub fn say(&self, text: &str) {
        self.voice().say(text);
    }

    /// To say something while another one shows progress.
    pub fn voice(&self) -> Voice {
        Voice(self.bar.clone())
    }

    /// Says on a terminal, or where asked for, how far it is.
    pub fn note(&self, text: &str) {
        if self.verbose || std::io::stderr().is_terminal() {
            self.say(text);
        }
    }

    /// The work of the present part begins anew.
    pub fn start_again(&mut self) {
        self.stage.clear();
        self.bar.set_position((self.part[0] * STEPS) as u64);
    }

    /// Takes the bar away.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }

    /// Since the start, s.
    pub fn seconds(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }
}

/// Says things beside the bar.
pub struct Voice(ProgressBar);

impl Voice {
    /// Says something that stays.
    pub fn say(&self, text: &str) {
        self.0.suspend(|| say_on_stderr(printable(text)));
    }
}

fn style() -> ProgressStyle {
    let style = ProgressStyle::default_bar().progress_chars("=> ");
    let styled = style.template("{seconds} [{bar:20}] {percent:>3} %{pace} {wide_msg}");
    // The template is a constant: a wrong one shows the usual bar.
    styled
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("seconds", |state: &ProgressState, text: &mut dyn Write| {
            // Writing into the line's text cannot fail.
            let _ = write!(text, "{:6.1} s", state.elapsed().as_secs_f64());
        })
        .with_key("pace", |state: &ProgressState, text: &mut dyn Write| {
            let _ = text.write_str(&pace(state.elapsed().as_secs_f64(), f64::from(state.fraction())));
        })
}

/// Rate and time left after so many seconds; empty while too little is done to tell.
fn pace(seconds: f64, fraction: f64) -> String {
    if !(0.01..1.0).contains(&fraction) || seconds <= 0.0 {
        return String::new();
    }
    let left = (seconds * (1.0 - fraction) / fraction).ceil();
    let left = if left < 90.0 { format!("{left:.0} s") } else { format!("{:.0} min", (left / 60.0).ceil()) };
    format!("  {:.1} %/s, {left} left", fraction * 100.0 / seconds)
}

/// Share of the whole that is done when a stage has done this share of its own work.
fn whole(stage: &str, fraction: f64, skipped: f64) -> f64 {
    let Some(place) = SHARES.iter().position(|(name, _)| *name == stage) else { return fraction };
    let before: f64 = SHARES[..place].iter().map(|(_, share)| share).sum();
    (((before + SHARES[place].1 * fraction) - skipped) / (1.0 - skipped)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_follow_one_another_to_the_end() {
        let mut last = 0.0;
        for (stage, share) in SHARES {
            assert!((whole(stage, 0.0, 0.0) - last).abs() < 1e-12, "{stage}");
            last += share;
            assert!((whole(stage, 1.0, 0.0) - last).abs() < 1e-12, "{stage}");
        }
        assert!((last - 1.0).abs() < 1e-12);
        // A replay of the last stage alone, and a controller's own share.
        assert!((whole(nodes::MACHINE_INTERFACE, 0.5, 0.95) - 0.5).abs() < 1e-12);
        assert_eq!(whole("running", 0.25, 0.0), 0.25);
    }

    #[test]
    fn what_is_left_goes_by_what_was_done() {
        assert_eq!(pace(10.0, 0.25), "  2.5 %/s, 30 s left");
        assert_eq!(pace(60.0, 0.1), "  0.2 %/s, 9 min left");
        assert_eq!((pace(5.0, 0.0), pace(5.0, 1.0)), (String::new(), String::new()));
    }

    #[test]
    fn parts_and_repeats_move_the_bar_as_they_should() {
        let mut line = ProgressLine::new(false);
        line.set_part(1, 4);
        line.show_stage("running", "", 0.5);
        assert_eq!(line.bar.position(), 3750);
        line.show_stage("running", "", 0.1);
        assert_eq!(line.bar.position(), 3750);
        line.start_again();
        assert_eq!(line.bar.position(), 2500);
    }
}
