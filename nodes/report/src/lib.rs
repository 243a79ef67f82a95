//! What a person sees of a finished plan: `report.html` in one file, and pictures without a browser.
//!
//! Pure: products in, text or picture out; no ROS, no I/O. SI units come in, mm and degrees are shown.

pub mod axes;
pub mod blob;
pub mod map_colours;
pub mod page;
pub mod picture;
pub mod plan;
pub mod raster;
pub mod sections;
pub mod shown_surface;
pub mod track;
pub mod warnings;

pub use page::report;
pub use picture::{Format, What, picture};
pub use plan::{Plan, Refused};
