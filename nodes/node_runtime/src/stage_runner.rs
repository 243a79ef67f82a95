//! Runs a stage's blocking function, one job at a time: a newer job cancels the older one.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::msg::Job;
use patchmill_products as products;
use patchmill_products::stage::{Progress, StageError};
use patchmill_products::wire::Provenance;
use tokio::sync::{Mutex, mpsc};

use crate::product_receiver::Received;
use crate::products::{LargeProduct, ProductKey};
use crate::status::StatusPublisher;

/// Which work: surface, job and the stamp of its run. Without a job the last two are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JobTag {
    /// Content hash of the surface.
    pub surface_id: String,
    /// Content hash of the job; empty without one.
    pub job_id: String,
    /// Stamp of the job's message.
    pub stamp: Time,
}

impl JobTag {
    /// Of a job's message.
    pub fn of_job(job: &Job) -> Self {
        Self {
            surface_id: job.surface_id.clone(),
            job_id: job.job_id.clone(),
            stamp: job.header.stamp.clone(),
        }
    }

    /// Of a product's key.
    pub fn of_key(key: &ProductKey) -> Self {
        let (sec, nanosec) = key.stamp;
        Self { surface_id: key.surface_id.clone(), job_id: key.job_id.clone(), stamp: Time { sec, nanosec } }
    }

    /// Of a product's origin.
    pub fn of_provenance(provenance: &Provenance) -> Self {
        Self {
            surface_id: provenance.surface_id.clone(),
            job_id: provenance.job_id.clone(),
            stamp: provenance.stamp.clone(),
        }
    }

    /// Surface and job as log lines end in them: ` [surface=… job=…]`, the first twelve digits of their ids; nothing of what is not known.
    pub fn in_log(&self) -> String {
        in_log(&self.surface_id, &self.job_id)
    }

    /// The same as the origin of products.
    pub fn provenance(&self) -> Provenance {
        Provenance {
            stamp: self.stamp.clone(),
            surface_id: self.surface_id.clone(),
            job_id: self.job_id.clone(),
        }
    }
}

struct Ended<T> {
    run: u64,
    tag: JobTag,
    result: Result<T, StageError>,
}

/// Runs a blocking function in a thread of its own, keeps the status, and lets go of work that is no longer wanted.
pub struct StageRunner<T> {
    status: StatusPublisher,
    run: u64,
    cancelled: Option<Arc<AtomicBool>>,
    sender: mpsc::UnboundedSender<Ended<T>>,
    receiver: mpsc::UnboundedReceiver<Ended<T>>,
    /// Held by the work that is done.
    turn: Arc<Mutex<()>>,
}

impl<T: Send + 'static> StageRunner<T> {
    /// Idle.
    pub fn new(status: StatusPublisher) -> Self {
        let (sender, receiver) = mpsc::unbounded_channel();
        Self { status, run: 0, cancelled: None, turn: Arc::default(), sender, receiver }
    }

    /// The status, for what the runner does not say itself (WAITING, DONE).
    pub fn status(&self) -> &StatusPublisher {
        &self.status
    }

    /// Cancels what runs and starts `work`. The status becomes RUNNING with `text`, and follows the progress.
    pub fn start<W>(&mut self, tag: JobTag, text: &str, work: W)
    where
        W: FnOnce(Progress<'_>) -> Result<T, StageError> + Send + 'static,
    {
        self.cancel();
        self.run += 1;
        let (run, sender, status) = (self.run, self.sender.clone(), self.status.clone());
        let (cancelled, text) = (Arc::new(AtomicBool::new(false)), text.to_owned());
        self.cancelled = Some(Arc::clone(&cancelled));
        self.status.running(&tag, &text);
        let running_tag = tag.clone();
        let turn = Arc::clone(&self.turn);
        let given_up = Arc::clone(&cancelled);
        let blocking = move || {
            let report = |fraction: f64| {
                if !cancelled.load(Ordering::Relaxed) {
                    status.progress(&running_tag, fraction, &text);
                }
            };
            work(Progress { cancelled: &cancelled, report: &report })
        };
        tokio::spawn(async move {
            // One after the other: what is cancelled ends soon, and holds its memory until then. What is cancelled before its turn is not begun.
            let turn = turn.lock().await;
            if given_up.load(Ordering::Relaxed) {
                return;
            }
            let result = match tokio::task::spawn_blocking(blocking).await {
                Ok(result) => result,
                Err(e) => Err(StageError::new(INTERNAL, format!("the stage broke down: {e}"))),
            };
            drop(turn);
            // The runner may be gone; then nobody wants the result.
            let _ = sender.send(Ended { run, tag, result });
        });
    }

    /// Takes a job's message, cancelling older work: the job, or nothing when the job was withdrawn (empty `job_id`) or is
    /// not valid; then the status says so with `code`.
    pub fn take_job(&mut self, message: &Job, code: i32) -> Option<(JobTag, Arc<products::job::Job>)> {
        self.cancel();
        let tag = JobTag::of_job(message);
        if message.job_id.is_empty() {
            self.status.idle();
            return None;
        }
        match products::job::Job::from_msg(message) {
            Ok(job) => Some((tag, Arc::new(job))),
            Err(e) => {
                self.status.failed(&tag, &e.with_code(code));
                None
            }
        }
    }

    /// Takes what a receiver hands over; a product that did not come whole is reported as the failure of its job.
    pub fn received<P: LargeProduct>(&self, received: Received<P>) -> Option<(ProductKey, P)> {
        match received {
            Received::Product { key, product, .. } => Some((key, product)),
            Received::Failed { key, text } => {
                let text = format!("the {} did not arrive: {text}", P::WHAT);
                self.status.failed(&JobTag::of_key(&key), &StageError::new(P::CODE, text));
                None
            }
        }
    }

    /// Whether work is wanted and has not ended.
    pub fn is_running(&self) -> bool {
        self.cancelled.is_some()
    }

    /// Cancels what runs; its result will not be seen.
    pub fn cancel(&mut self) {
        if let Some(cancelled) = self.cancelled.take() {
            cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// The end of the newest work, once; older work that was cancelled is passed over. On an error the status has become
    /// FAILED; on success the caller publishes the products and says [`StatusPublisher::done`]. Cancel-safe.
    pub async fn finished(&mut self) -> (JobTag, Result<T, StageError>) {
        loop {
            match self.receiver.recv().await {
                Some(ended) if ended.run == self.run && self.cancelled.is_some() => {
                    self.cancelled = None;
                    if let Err(error) = &ended.result {
                        self.status.failed(&ended.tag, error);
                    }
                    return (ended.tag, ended.result);
                }
                Some(_) => {}
                None => std::future::pending().await,
            }
        }
    }
}

impl<T> Drop for StageRunner<T> {
    fn drop(&mut self) {
        if let Some(cancelled) = &self.cancelled {
            cancelled.store(true, Ordering::Relaxed);
        }
    }
}

/// As [`JobTag::in_log`].
pub(crate) fn in_log(surface_id: &str, job_id: &str) -> String {
    let known = [("surface", surface_id), ("job", job_id)].into_iter().filter(|(_, id)| !id.is_empty());
    let parts: Vec<String> =
        known.map(|(key, id)| format!("{key}={}", id.chars().take(12).collect::<String>())).collect();
    if parts.is_empty() { String::new() } else { format!(" [{}]", parts.join(" ")) }
}

/// Code of a stage that panicked.
pub const INTERNAL: i32 = 2;
