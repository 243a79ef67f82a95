//! Where a product comes from: the run, the surface, the job.

use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::std_msgs::msg::Header;

use super::WireError;
use crate::job::Job;

/// Frame of every product.
pub const FRAME: &str = "workpiece";

/// Longest id that is accepted, bytes.
const MAX_ID: usize = 256;

/// What every product's message says of its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Provenance {
    /// Of the run of the job, or of the load of the surface.
    pub stamp: Time,
    /// Content hash of the surface.
    pub surface_id: String,
    /// Content hash of the job; empty for what depends on the surface alone.
    pub job_id: String,
}

impl Provenance {
    /// Of a surface's mesh and samples, with the time when it was loaded.
    pub fn of_surface(stamp: Time, surface_id: &str) -> Self {
        Self { stamp, surface_id: surface_id.to_owned(), job_id: String::new() }
    }

    /// Of a product made for a job, with the stamp of the job's message.
    pub fn of_job(stamp: Time, job: &Job) -> Self {
        Self { stamp, surface_id: job.surface_id.clone(), job_id: job.job_id.clone() }
    }

    /// The header of its messages.
    pub fn header(&self) -> Header {
        Header { stamp: self.stamp.clone(), frame_id: FRAME.to_owned() }
    }

    /// From a message's header and ids.
    ///
    /// # Errors
    /// When the frame is not `workpiece` or an id is overlong.
    pub fn read(header: &Header, surface_id: &str, job_id: &str) -> Result<Self, WireError> {
        if header.frame_id != FRAME {
            let frame = &header.frame_id;
            return Err(WireError::new(format!(
                "a product in the frame '{frame}' came, '{FRAME}' was expected"
            )));
        }
        check_id("surface_id", surface_id)?;
        check_id("job_id", job_id)?;
        Ok(Self { stamp: header.stamp.clone(), surface_id: surface_id.to_owned(), job_id: job_id.to_owned() })
    }
}

pub(super) fn check_id(name: &str, id: &str) -> Result<(), WireError> {
    if id.len() > MAX_ID {
        return Err(WireError::new(format!(
            "{name} is {} bytes long, at most {MAX_ID} were expected",
            id.len()
        )));
    }
    Ok(())
}
