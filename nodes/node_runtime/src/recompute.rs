//! The service `<node>/recompute`: runs a stage again on the inputs that it holds.

use patchmill_msgs::srv::{Recompute, RecomputeRequest, RecomputeResponse};
use patchmill_products::stage::StageError;
use tokio::sync::{mpsc, oneshot};

use crate::node::Node;
use crate::stage_runner::JobTag;
use crate::{RuntimeError, topics};

/// Calls of the service, one after the other.
pub struct RecomputeServer {
    calls: mpsc::UnboundedReceiver<(RecomputeRequest, oneshot::Sender<RecomputeResponse>)>,
    /// First code of the stage's hundred.
    code: i32,
}

impl RecomputeServer {
    /// Offers the service; refusals carry `code`.
    ///
    /// # Errors
    /// As [`Node::serve`].
    pub fn new(node: &Node, code: i32) -> Result<Self, RuntimeError> {
        let (sender, calls) = mpsc::unbounded_channel();
        node.serve::<Recompute, _, _>(&topics::recompute(node.role()), move |request| {
            let (reply, answer) = oneshot::channel();
            let sent = sender.send((request, reply));
            async move {
                let stopping = || RecomputeResponse { code, text: "the node is shutting down".to_owned() };
                if sent.is_err() {
                    return stopping();
                }
                answer.await.unwrap_or_else(|_| stopping())
            }
        })?;
        Ok(Self { calls, code })
    }

    /// The next call. Cancel-safe.
    pub async fn next(&mut self) -> RecomputeCall {
        match self.calls.recv().await {
            Some((request, reply)) => RecomputeCall { job_id: request.job_id, reply, code: self.code },
            None => std::future::pending().await,
        }
    }
}

/// One call, to be answered.
pub struct RecomputeCall {
    job_id: String,
    reply: oneshot::Sender<RecomputeResponse>,
    code: i32,
}

impl RecomputeCall {
    /// Whether the call means the job that the stage holds; otherwise it is refused here.
    pub fn accept(self, held: Option<&JobTag>) -> Option<Self> {
        match held {
            Some(tag) if tag.job_id == self.job_id => Some(self),
            _ => {
                let held = held.map_or("none", |tag| tag.job_id.as_str());
                let text = format!("job '{}' is not here; the stage holds: {held}", self.job_id);
                let code = self.code;
                self.answer(Err(StageError::new(code, text)));
                None
            }
        }
    }

    /// Answers whether the work was started.
    pub fn answer(self, started: Result<(), StageError>) {
        let response = match started {
            Ok(()) => RecomputeResponse::default(),
            Err(e) => RecomputeResponse { code: e.code, text: e.text },
        };
        // The caller may be gone.
        let _ = self.reply.send(response);
    }
}
