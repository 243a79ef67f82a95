//! A Foxglove WebSocket with every topic of a run: a node that subscribes to them over DDS and passes each message on as CDR with
//! its ros2msg schema.

mod lane;
mod latch;
pub mod node;
