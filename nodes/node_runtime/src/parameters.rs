//! Typed parameters with description, bounds and read-only; bad values are refused at start and at run time.

use std::fmt;
use std::ops::RangeInclusive;

use ros2_client::ParameterValue;
use ros2_client::parameters::{NumericRange, ParameterDescriptor, raw};

use crate::RuntimeError;
use crate::arguments::Arguments;

/// A parameter's value.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// true or false
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A real number.
    Double(f64),
    /// Text.
    Text(String),
    /// A list of real numbers.
    Doubles(Vec<f64>),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(v) => write!(f, "{v}"),
            Self::Integer(v) => write!(f, "{v}"),
            Self::Double(v) => write!(f, "{v}"),
            Self::Text(v) => write!(f, "'{v}'"),
            Self::Doubles(v) => write!(f, "{v:?}"),
        }
    }
}

impl Value {
    fn kind(&self) -> &'static str {
        match self {
            Self::Bool(_) => "true or false",
            Self::Integer(_) => "a whole number",
            Self::Double(_) => "a number",
            Self::Text(_) => "text",
            Self::Doubles(_) => "a list of numbers",
        }
    }

    pub(crate) fn to_ros(&self) -> ParameterValue {
        match self {
            Self::Bool(v) => ParameterValue::Boolean(*v),
            Self::Integer(v) => ParameterValue::Integer(*v),
            Self::Double(v) => ParameterValue::Double(*v),
            Self::Text(v) => ParameterValue::String(v.clone()),
            Self::Doubles(v) => ParameterValue::DoubleArray(v.clone()),
        }
    }

    pub(crate) fn from_ros(value: &ParameterValue) -> Option<Self> {
        match value {
            ParameterValue::Boolean(v) => Some(Self::Bool(*v)),
            ParameterValue::Integer(v) => Some(Self::Integer(*v)),
            ParameterValue::Double(v) => Some(Self::Double(*v)),
            ParameterValue::String(v) => Some(Self::Text(v.clone())),
            ParameterValue::DoubleArray(v) => Some(Self::Doubles(v.clone())),
            _ => None,
        }
    }
}

/// Every ROS node has this one.
const USE_SIM_TIME: &str = "use_sim_time";

type Check = Box<dyn Fn(&Value) -> Result<(), String> + Send + Sync>;

struct Declared {
    name: String,
    default: Value,
    description: String,
    bounds: Option<(f64, f64)>,
    read_only: bool,
    check: Option<Check>,
}

impl Declared {
    /// The value in the declared type, or why it is refused.
    fn accept(&self, value: Value) -> Result<Value, String> {
        let value = match (&self.default, value) {
            (Value::Double(_), Value::Integer(i)) => Value::Double(i as f64),
            (_, value) => value,
        };
        let name = &self.name;
        if std::mem::discriminant(&value) != std::mem::discriminant(&self.default) {
            return Err(format!("parameter '{name}' is {value}: expected {}", self.default.kind()));
        }
        let number = match &value {
            Value::Integer(i) => Some(*i as f64),
            Value::Double(d) => Some(*d),
            _ => None,
        };
        if let (Some(number), Some((low, high))) = (number, self.bounds)
            && !(low..=high).contains(&number)
        {
            return Err(format!("parameter '{name}' is {value}: expected {low} to {high}"));
        }
        if let Some(check) = &self.check {
            check(&value).map_err(|why| format!("parameter '{name}' is {value}: {why}"))?;
        }
        Ok(value)
    }
}

/// The parameters that a node has.
#[derive(Default)]
pub struct ParameterSet {
    declared: Vec<Declared>,
}

impl ParameterSet {
    /// None.
    pub fn new() -> Self {
        Self::default()
    }

    /// A bool.
    #[must_use]
    pub fn boolean(self, name: &str, default: bool, description: &str) -> Self {
        self.declare(name, Value::Bool(default), None, description)
    }

    /// A whole number within bounds.
    #[must_use]
    pub fn integer(self, name: &str, default: i64, bounds: RangeInclusive<i64>, description: &str) -> Self {
        let bounds = Some((*bounds.start() as f64, *bounds.end() as f64));
        self.declare(name, Value::Integer(default), bounds, description)
    }

    /// A real number within bounds.
    #[must_use]
    pub fn double(self, name: &str, default: f64, bounds: RangeInclusive<f64>, description: &str) -> Self {
        let bounds = Some((*bounds.start(), *bounds.end()));
        self.declare(name, Value::Double(default), bounds, description)
    }

    /// Text.
    #[must_use]
    pub fn text(self, name: &str, default: &str, description: &str) -> Self {
        self.declare(name, Value::Text(default.to_owned()), None, description)
    }

    /// Makes the parameter declared last unchangeable once the node runs.
    #[must_use]
    pub fn read_only(mut self) -> Self {
        if let Some(last) = self.declared.last_mut() {
            last.read_only = true;
        }
        self
    }

    /// Adds a rule to the parameter declared last; `Err` says what was expected.
    #[must_use]
    pub fn checked(mut self, check: impl Fn(&Value) -> Result<(), String> + Send + Sync + 'static) -> Self {
        if let Some(last) = self.declared.last_mut() {
            last.check = Some(Box::new(check));
        }
        self
    }

    /// A line a parameter, for `--help` and READMEs: name, default, description.
    pub fn table(&self) -> String {
        self.declared
            .iter()
            .map(|d| {
                let fixed = if d.read_only { " (read-only)" } else { "" };
                let bounds = d.bounds.map_or_else(String::new, |(l, h)| format!(", {l} to {h}"));
                format!("{} = {}{bounds}{fixed}: {}\n", d.name, d.default, d.description)
            })
            .collect()
    }

    /// Names and defaults, as declared.
    pub fn defaults(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.declared.iter().map(|d| (d.name.as_str(), &d.default))
    }

    fn declare(mut self, name: &str, default: Value, bounds: Option<(f64, f64)>, description: &str) -> Self {
        self.declared.push(Declared {
            name: name.to_owned(),
            default,
            description: description.to_owned(),
            bounds,
            read_only: false,
            check: None,
        });
        self
    }

    /// The start values: defaults with the overrides of the command line.
    pub(crate) fn start_values(&self, arguments: &Arguments) -> Result<Vec<(String, Value)>, RuntimeError> {
        self.refuse_unknown(arguments)?;
        self.declared
            .iter()
            .map(|d| {
                let value = arguments.override_of(&d.name).unwrap_or(&d.default).clone();
                let value = d.accept(value).map_err(RuntimeError::Parameter)?;
                Ok((d.name.clone(), value))
            })
            .collect()
    }

    fn refuse_unknown(&self, arguments: &Arguments) -> Result<(), RuntimeError> {
        let known = |name: &str| {
            name == USE_SIM_TIME
                || name.starts_with("qos_overrides.")
                || self.declared.iter().any(|d| d.name == name)
        };
        let unknown = arguments
            .overrides
            .iter()
            .find(|o| o.strict && o.node.as_deref().is_none_or(|n| n == arguments.name) && !known(&o.name));
        match unknown {
            None => Ok(()),
            Some(o) => {
                let names: Vec<&str> = self.declared.iter().map(|d| d.name.as_str()).collect();
                Err(RuntimeError::Parameter(format!(
                    "{} has no parameter '{}': it has {}",
                    arguments.name,
                    o.name,
                    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
                )))
            }
        }
    }

    /// The names in order, with the one that every ROS node has.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        let mut names: Vec<&str> = self.declared.iter().map(|d| d.name.as_str()).collect();
        names.push(USE_SIM_TIME);
        names.sort_unstable();
        names.into_iter()
    }

    /// What `describe_parameters` says of one; `None` when there is no such parameter.
    pub(crate) fn descriptor(&self, name: &str) -> Option<raw::ParameterDescriptor> {
        if name == USE_SIM_TIME {
            let mut descriptor = ParameterDescriptor::from_value(name, &ParameterValue::Boolean(false));
            "take the time from /clock (accepted, without effect: stamps are of this machine's clock)"
                .clone_into(&mut descriptor.description);
            return Some(descriptor.into());
        }
        let declared = self.declared.iter().find(|d| d.name == name)?;
        let mut descriptor = ParameterDescriptor::from_value(name, &declared.default.to_ros());
        descriptor.description.clone_from(&declared.description);
        descriptor.read_only = declared.read_only;
        if declared.check.is_some() {
            "checked by the node; a refusal gives the reason"
                .clone_into(&mut descriptor.additional_constraints);
        }
        descriptor.range = match (&declared.default, declared.bounds) {
            (Value::Integer(_), Some((low, high))) => {
                NumericRange::IntegerRange { from_value: low as i64, to_value: high as i64, step: 0 }
            }
            (_, Some((from_value, to_value))) => {
                NumericRange::FloatingPointRange { from_value, to_value, step: 0.0 }
            }
            (_, None) => NumericRange::NotSpecified,
        };
        Some(descriptor.into())
    }

    /// A whole number for a real one becomes a real one; everything else stays.
    pub(crate) fn in_declared_type(&self, name: &str, value: ParameterValue) -> ParameterValue {
        let real = self.declared.iter().any(|d| d.name == name && matches!(d.default, Value::Double(_)));
        match value {
            ParameterValue::Integer(i) if real => ParameterValue::Double(i as f64),
            value => value,
        }
    }

    /// What may be set while the node runs.
    pub(crate) fn validate(&self, name: &str, value: &ParameterValue) -> Result<(), String> {
        if name == USE_SIM_TIME {
            return match value {
                ParameterValue::Boolean(_) => Ok(()),
                _ => Err(format!("parameter '{name}': expected true or false")),
            };
        }
        let Some(declared) = self.declared.iter().find(|d| d.name == name) else {
            return Err(format!("there is no parameter '{name}'"));
        };
        if declared.read_only {
            return Err(format!("parameter '{name}' is read-only"));
        }
        let value = Value::from_ros(value)
            .ok_or_else(|| format!("parameter '{name}': expected {}", declared.default.kind()))?;
        declared.accept(value).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set() -> ParameterSet {
        ParameterSet::new()
            .double("chord_mm", 0.5, 0.001..=10.0, "chord")
            .integer("threads", 0, 0..=64, "threads")
            .read_only()
            .text("dir", ".", "directory")
            .checked(
                |v| if *v == Value::Text("no".to_owned()) { Err("expected yes".to_owned()) } else { Ok(()) },
            )
    }

    fn start(line: &str) -> Result<Vec<(String, Value)>, RuntimeError> {
        let line = format!("--ros-args {line}");
        let arguments = Arguments::parse(line.split_whitespace().map(str::to_owned), "n", |_| None).unwrap();
        set().start_values(&arguments)
    }

    #[test]
    fn overrides_are_checked_against_the_declaration() {
        assert_eq!(start("-p chord_mm:=2").unwrap()[0].1, Value::Double(2.0));
        for (line, expected) in [
            ("-p chord_mm:=0", "parameter 'chord_mm' is 0: expected 0.001 to 10"),
            ("-p chord_mm:=abc", "parameter 'chord_mm' is 'abc': expected a number"),
            ("-p dir:=no", "parameter 'dir' is 'no': expected yes"),
            ("-p chrod:=1", "n has no parameter 'chrod': it has chord_mm, threads, dir"),
        ] {
            assert_eq!(start(line).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn what_is_set_while_the_node_runs_is_validated() {
        let refusal = |name: &str, value| set().validate(name, &value).unwrap_err();
        assert_eq!(refusal("threads", ParameterValue::Integer(3)), "parameter 'threads' is read-only");
        assert_eq!(refusal("chord_mm", ParameterValue::NotSet), "parameter 'chord_mm': expected a number");
        assert_eq!(
            refusal("chord_mm", ParameterValue::Double(11.0)),
            "parameter 'chord_mm' is 11: expected 0.001 to 10"
        );
        assert_eq!(
            refusal("use_sim_time", ParameterValue::Integer(1)),
            "parameter 'use_sim_time': expected true or false"
        );
        assert_eq!(refusal("none", ParameterValue::Integer(1)), "there is no parameter 'none'");
        assert!(set().validate("chord_mm", &ParameterValue::Integer(2)).is_ok());
        assert_eq!(
            set().in_declared_type("chord_mm", ParameterValue::Integer(2)),
            ParameterValue::Double(2.0)
        );
    }

    #[test]
    fn descriptors_have_range_and_read_only() {
        let chord = set().descriptor("chord_mm").unwrap();
        assert_eq!((chord.description.as_str(), chord.read_only), ("chord", false));
        assert_eq!(
            (chord.floating_point_range[0].from_value, chord.floating_point_range[0].to_value),
            (0.001, 10.0)
        );
        let threads = set().descriptor("threads").unwrap();
        assert!(threads.read_only && threads.floating_point_range.is_empty());
        assert_eq!((threads.integer_range[0].from_value, threads.integer_range[0].to_value), (0, 64));
        assert!(set().descriptor("none").is_none());
    }
}
