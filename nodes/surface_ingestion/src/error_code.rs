//! Numeric codes of this stage's errors, 1xx.

/// A parameter is out of its range.
pub const BAD_PARAMETER: i32 = 101;
/// The file is missing, not a regular file, outside the allowed directory, too big or cannot be read.
pub const UNREADABLE_FILE: i32 = 110;
/// The content is not a surface that this stage knows.
pub const BAD_CONTENT: i32 = 111;
/// The unit is unknown.
pub const BAD_UNITS: i32 = 112;
/// The expression has a syntax error or an unknown name.
pub const BAD_EXPRESSION: i32 = 113;
/// The surface is singular somewhere: a pole, an undefined value, a vanishing normal.
pub const SINGULAR_SURFACE: i32 = 114;
/// The chord tolerance needs more triangles than allowed.
pub const TOO_MANY_TRIANGLES: i32 = 115;
/// The triangles do not form an orientable surface.
pub const BAD_TOPOLOGY: i32 = 116;
/// The points are noisier than allowed.
pub const NOISY_CLOUD: i32 = 117;
/// No cloud has come on the topic.
pub const NO_CLOUD: i32 = 118;
/// The cloud is in another frame than the workpiece's.
pub const FOREIGN_FRAME: i32 = 119;
/// Nothing is selected, or what is selected by number is not there; a closed solid comes without a selection.
pub const BAD_SELECTION: i32 = 120;
