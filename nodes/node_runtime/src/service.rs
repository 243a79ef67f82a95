//! Services. Every request must be idempotent: clients repeat them, because a first call can be lost.

use std::future::Future;
use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use futures::stream::FuturesUnordered;
use futures::{FutureExt, StreamExt};
use patchmill_msgs::{RosType, ServiceType, cdr};
use ros2_client::qos::{Durability, History, QosProfile, WhenFull};
use ros2_client::{RmwRequestId, ServiceMapping, ServiceTypeName};
use tokio::sync::Mutex;

use crate::RuntimeError;
use crate::node::{Node, parse_name};
use crate::wire_type::{Wire, package_and_name};

pub(crate) fn service_qos() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Wait(Duration::from_secs(1)))
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 16 })
}

struct InFlight {
    request: Vec<u8>,
    answer_to: Vec<RmwRequestId>,
}

impl Node {
    /// Answers requests. `handle` runs on the node's task: give long work to a blocking thread. Equal requests that
    /// come while one is being handled get the same answer (they are repetitions).
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn serve<S, F, Fut>(&self, name: &str, handle: F) -> Result<(), RuntimeError>
    where
        S: ServiceType,
        F: Fn(S::Request) -> Fut + Send + Sync + 'static,
        Fut: Future<Output = S::Response> + Send + 'static,
    {
        let name = self.resolve(name);
        let ros_name = parse_name(&name)?;
        let (package, service) = package_and_name(S::NAME);
        let type_name = ServiceTypeName::new(package, service);
        let server = self.with_node(&name, |node| {
            node.create_server::<Wire<S::Request>, Wire<S::Response>>(
                ServiceMapping::Enhanced,
                &ros_name,
                &type_name,
                service_qos(),
                service_qos(),
            )
            .map_err(|e| e.to_string())
        })?;
        let node = self.clone();
        self.spawn(async move {
            let mut requests = server.receive_request_stream();
            let mut in_flight: Vec<InFlight> = Vec::new();
            let mut running = FuturesUnordered::new();
            loop {
                tokio::select! {
                    request = requests.next() => match request {
                        None => break,
                        Some(Err(e)) => node.warn(format!("a request to {name} was dropped: {e}")),
                        Some(Ok((id, Wire(request)))) => {
                            let bytes = cdr::to_cdr(&request);
                            match in_flight.iter_mut().find(|f| f.request == bytes) {
                                Some(same) => same.answer_to.push(id),
                                None => {
                                    in_flight.push(InFlight { request: bytes.clone(), answer_to: vec![id] });
                                    // The handler's own part is run at once, its future with the others.
                                    let handling = catch_unwind(AssertUnwindSafe(|| handle(request)));
                                    let handled = async move { AssertUnwindSafe(handling?).catch_unwind().await };
                                    running.push(handled.map(move |response| (bytes, response)));
                                }
                            }
                        }
                    },
                    Some((bytes, response)) = running.next(), if !running.is_empty() => {
                        let place = in_flight.iter().position(|f| f.request == bytes);
                        let asked = place.map(|place| in_flight.swap_remove(place).answer_to);
                        let Ok(response) = response else {
                            node.error(format!("a request to {name} was not answered: its handler broke down"));
                            continue;
                        };
                        if let Some(asked) = asked {
                            for id in asked {
                                if let Err(e) = server.async_send_response(id, Wire(response.clone())).await {
                                    node.warn(format!("an answer of {name} was lost: {e}"));
                                }
                            }
                        }
                    }
                }
            }
        });
        Ok(())
    }

    /// A client of a service.
    ///
    /// # Errors
    /// When the name is none or DDS refuses.
    pub fn service_client<S: ServiceType>(&self, name: &str) -> Result<ServiceClient<S>, RuntimeError> {
        let name = self.resolve(name);
        let ros_name = parse_name(&name)?;
        let (package, service) = package_and_name(S::NAME);
        let type_name = ServiceTypeName::new(package, service);
        let client = self.with_node(&name, |node| {
            node.create_client::<Wire<S::Request>, Wire<S::Response>>(
                ServiceMapping::Enhanced,
                &ros_name,
                &type_name,
                service_qos(),
                service_qos(),
            )
            .map_err(|e| e.to_string())
        })?;
        Ok(ServiceClient { node: self.clone(), client: Mutex::new(client), name, service: PhantomData })
    }
}

type RosClient<Q, R> = ros2_client::Client<Wire<Q>, Wire<R>>;

/// Calls a service, one call at a time.
pub struct ServiceClient<S: ServiceType> {
    node: Node,
    client: Mutex<RosClient<S::Request, S::Response>>,
    name: String,
    service: PhantomData<S>,
}

impl<S: ServiceType> ServiceClient<S> {
    /// Calls the service, waiting for it to appear and repeating the request every `attempt`, until `deadline` from now.
    ///
    /// # Errors
    /// [`RuntimeError::Unavailable`] or [`RuntimeError::NoAnswer`] after the deadline.
    pub async fn call(
        &self,
        request: &S::Request,
        attempt: Duration,
        deadline: Duration,
    ) -> Result<S::Response, RuntimeError> {
        let client = self.client.lock().await;
        let end = Instant::now() + deadline;
        let unavailable = || RuntimeError::Unavailable { name: self.name.clone(), waited: deadline };
        let ready = wait_until(end, || self.is_ready(&client)).await;
        if !ready {
            return Err(unavailable());
        }
        loop {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(RuntimeError::NoAnswer { name: self.name.clone(), waited: deadline });
            }
            let call = client.async_call_service(Wire(request.clone()));
            match tokio::time::timeout(attempt.min(left), call).await {
                Ok(Ok(Wire(response))) => return Ok(response),
                // An answer that cannot be read; the next is likely to be no better, but costs little.
                Ok(Err(_)) => tokio::time::sleep(Duration::from_millis(20)).await,
                Err(_) => {}
            }
        }
    }

    /// Whether a server is matched at present.
    fn is_ready(&self, client: &RosClient<S::Request, S::Response>) -> bool {
        client_is_ready(&self.node, client)
    }
}

pub(crate) fn client_is_ready<Q: RosType, R: RosType>(node: &Node, client: &RosClient<Q, R>) -> bool {
    // wait_for_service borrows the node, so it is not awaited but asked whether it would wait.
    node.lock().as_ref().is_some_and(|node| client.wait_for_service(node).now_or_never().is_some())
}

/// Asks every 20 ms; `false` when the time is over.
pub(crate) async fn wait_until(end: Instant, condition: impl Fn() -> bool) -> bool {
    while !condition() {
        if Instant::now() >= end {
            return false;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    true
}
