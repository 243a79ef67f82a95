//! The six parameter services of a node (package `rcl_interfaces`). ros2-client has its own, but they know neither description
//! nor range nor read-only, and an unreadable request would end them.

use std::sync::Arc;

use futures::StreamExt;
use ros2_client::parameters::{Parameter, ParameterValue, SetParametersResult, raw};
use ros2_client::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, GetParameterTypesRequest,
    GetParameterTypesResponse, GetParametersRequest, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, ListParametersResult, SetParametersAtomicallyResponse, SetParametersRequest,
    SetParametersResponse,
};
use ros2_client::{Message, ServiceMapping, ServiceTypeName};

use crate::RuntimeError;
use crate::node::{Node, parse_name};
use crate::parameters::ParameterSet;
use crate::service::service_qos;

impl Node {
    /// Offers `~/list_parameters`, `describe_…`, `get_…`, `get_parameter_types`, `set_…` and `set_…_atomically`.
    pub(crate) fn serve_parameters(&self, declared: &Arc<ParameterSet>) -> Result<(), RuntimeError> {
        let set = Arc::clone(declared);
        self.serve_rcl("list_parameters", "ListParameters", move |_, request: ListParametersRequest| {
            ListParametersResponse { result: list(&set, &request) }
        })?;
        let set = Arc::clone(declared);
        self.serve_rcl(
            "describe_parameters",
            "DescribeParameters",
            move |_, request: DescribeParametersRequest| {
                // As rclcpp: an unknown name makes the whole answer empty.
                let values = request.names.iter().map(|name| set.descriptor(name)).collect::<Option<_>>();
                DescribeParametersResponse { values: values.unwrap_or_default() }
            },
        )?;
        self.serve_rcl("get_parameters", "GetParameters", |node, request: GetParametersRequest| {
            let values = request.names.iter().map(|name| node.ros_parameter(name).map(Into::into));
            GetParametersResponse { values: values.collect::<Option<_>>().unwrap_or_default() }
        })?;
        self.serve_rcl(
            "get_parameter_types",
            "GetParameterTypes",
            |node, request: GetParameterTypesRequest| {
                let kind = |name: &String| {
                    node.ros_parameter(name).map(|value| ParameterValue::to_parameter_type_raw(&value))
                };
                let values = request.names.iter().map(kind).collect::<Option<_>>();
                GetParameterTypesResponse { values: values.unwrap_or_default() }
            },
        )?;
        let set = Arc::clone(declared);
        self.serve_rcl("set_parameters", "SetParameters", move |node, request: SetParametersRequest| {
            let one = |p: raw::Parameter| result(node.set_ros_parameters(&set, vec![p.into()]));
            SetParametersResponse { results: request.parameter.into_iter().map(one).collect() }
        })?;
        let set = Arc::clone(declared);
        self.serve_rcl(
            "set_parameters_atomically",
            "SetParametersAtomically",
            move |node, request: SetParametersRequest| {
                let all = request.parameter.into_iter().map(Into::into).collect();
                SetParametersAtomicallyResponse { result: result(node.set_ros_parameters(&set, all)) }
            },
        )
    }

    fn ros_parameter(&self, name: &str) -> Option<ParameterValue> {
        self.lock().as_ref().and_then(|node| node.get_parameter(name))
    }

    /// All or none; each change goes out on `/parameter_events`.
    fn set_ros_parameters(&self, declared: &ParameterSet, wanted: Vec<Parameter>) -> SetParametersResult {
        for Parameter { name, value } in &wanted {
            declared.validate(name, value)?;
        }
        let guard = self.lock();
        let node = guard.as_ref().ok_or("the node is shutting down")?;
        wanted.into_iter().try_for_each(|Parameter { name, value }| {
            // The validator takes whole numbers for real ones; the store keeps the declared type.
            let value = declared.in_declared_type(&name, value);
            node.set_parameter(&name, value)
        })
    }

    fn serve_rcl<Q, R>(
        &self,
        name: &str,
        service: &str,
        answer: impl Fn(&Node, Q) -> R + Send + 'static,
    ) -> Result<(), RuntimeError>
    where
        Q: Message + Clone + Send + Sync + 'static,
        R: Message + Clone + Send + Sync + 'static,
    {
        let name = self.resolve(&format!("~/{name}"));
        let ros_name = parse_name(&name)?;
        let type_name = ServiceTypeName::new("rcl_interfaces", service);
        let server = self.with_node(&name, |node| {
            let mapping = ServiceMapping::Enhanced;
            node.create_server::<Q, R>(mapping, &ros_name, &type_name, service_qos(), service_qos())
                .map_err(|e| e.to_string())
        })?;
        let node = self.clone();
        self.spawn(async move {
            let mut requests = server.receive_request_stream();
            while let Some(request) = requests.next().await {
                match request {
                    Err(e) => node.warn(format!("a request to {name} was dropped: {e}")),
                    Ok((id, request)) => {
                        let response = answer(&node, request);
                        if let Err(e) = server.async_send_response(id, response).await {
                            node.warn(format!("an answer of {name} was lost: {e}"));
                        }
                    }
                }
            }
        });
        Ok(())
    }
}

fn result(set: SetParametersResult) -> raw::SetParametersResult {
    set.into()
}

/// As rclcpp lists: with no prefix all names; otherwise names that equal a prefix or lie below it. `depth` 0 is unlimited.
fn list(set: &ParameterSet, request: &ListParametersRequest) -> ListParametersResult {
    let within = |levels: usize| request.depth == 0 || (levels as u64) < request.depth;
    let wanted = |name: &str| {
        let below = |prefix: &String| {
            name.strip_prefix(prefix.as_str()).is_some_and(|rest| {
                rest.is_empty() || (rest.starts_with('.') && within(rest.matches('.').count()))
            })
        };
        if request.prefixes.is_empty() {
            within(name.matches('.').count())
        } else {
            request.prefixes.iter().any(below)
        }
    };
    let names: Vec<String> = set.names().filter(|name| wanted(name)).map(str::to_owned).collect();
    let mut prefixes: Vec<String> =
        names.iter().filter_map(|n| n.rsplit_once('.')).map(|(prefix, _)| prefix.to_owned()).collect();
    prefixes.sort();
    prefixes.dedup();
    ListParametersResult { names, prefixes }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_by_prefix_and_depth() {
        let set = ParameterSet::new()
            .integer("plain", 1, 0..=2, "")
            .integer("group.inner", 1, 0..=2, "")
            .integer("group.deep.er", 1, 0..=2, "");
        let names = |prefixes: &[&str], depth| {
            let prefixes = prefixes.iter().map(|p| (*p).to_owned()).collect();
            list(&set, &ListParametersRequest { prefixes, depth })
        };
        assert_eq!(names(&[], 0).names, ["group.deep.er", "group.inner", "plain", "use_sim_time"]);
        assert_eq!(names(&[], 1).names, ["plain", "use_sim_time"]);
        let group = names(&["group"], 0);
        assert_eq!(group.names, ["group.deep.er", "group.inner"]);
        assert_eq!(group.prefixes, ["group", "group.deep"]);
        assert_eq!(names(&["group"], 2).names, ["group.inner"]);
        assert_eq!(names(&["gro"], 0).names, [""; 0]);
    }
}
