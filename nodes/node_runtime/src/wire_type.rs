//! Generated types as ros2-client wants them for services and actions.

use patchmill_msgs::RosType;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A generated type on the wire: the same bytes, with ros2-client's marker trait.
#[derive(Clone, Serialize, Deserialize)]
#[serde(transparent)]
#[serde(bound = "T: Serialize + DeserializeOwned")]
pub(crate) struct Wire<T>(pub T);

impl<T: RosType> ros2_client::Message for Wire<T> {}

/// `package` and `Name` of `package/msg/Name`.
pub(crate) fn package_and_name(full: &str) -> (&str, &str) {
    let package = full.split('/').next().unwrap_or(full);
    let name = full.rsplit('/').next().unwrap_or(full);
    (package, name)
}
