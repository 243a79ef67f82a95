//! Faces, edges, surfaces and curves of a STEP file, by the numbers of their instances.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use nalgebra::{Point3, Vector3};

use crate::knots::{DEGREE_MAX, Knots};
use crate::nurbs::RationalNet;
use crate::step::part21::{Instance, Value};
use crate::step::shapes::{Curve, Frame, Profile, Shape};

/// Instances that place parts by a transformation, which is not read.
const ASSEMBLIES: [&str; 3] =
    ["NEXT_ASSEMBLY_USAGE_OCCURRENCE", "MAPPED_ITEM", "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"];
/// Faces that are no boundary representation.
const OTHER_GEOMETRY: [&str; 4] = [
    "TRIANGULATED_FACE",
    "COMPLEX_TRIANGULATED_FACE",
    "TRIANGULATED_SURFACE_SET",
    "COMPLEX_TRIANGULATED_SURFACE_SET",
];
/// Largest coordinate that is taken for a workpiece, m.
const COORDINATE_MAX: f64 = 1e3;
/// Units that are stated by other units, and curves by other curves, one after the other: more lead in a circle.
const CHAIN_MAX: usize = 8;

/// An edge: its curve, the points at its ends and what they are called.
pub struct Edge {
    /// The curve.
    pub curve: Curve,
    /// Instances of the vertices at the start and the end.
    pub vertices: [u64; 2],
    /// Their points, m.
    pub ends: [Point3<f64>; 2],
    /// Whether the curve's sense runs from the start to the end.
    pub forward: bool,
}

/// A use of an edge in a loop.
#[derive(Clone, Copy, Debug)]
pub struct Use {
    /// Instance of the EDGE_CURVE.
    pub edge: u64,
    /// Whether from its start to its end.
    pub forward: bool,
}

/// A trimmed surface.
pub struct Face {
    /// Instance of the ADVANCED_FACE.
    pub number: u64,
    /// Its surface.
    pub shape: Shape,
    /// Whether the face's normal is the surface's.
    pub same_sense: bool,
    /// The loops that bound it.
    pub loops: Vec<Vec<Use>>,
}

/// What is read of a file.
pub struct Model {
    /// The faces in the order of their numbers.
    pub faces: Vec<Face>,
    /// The edges that they use.
    pub edges: BTreeMap<u64, Edge>,
}

/// The faces of `instances`.
///
/// # Errors
/// Naming the instance that is missing, malformed or of a kind that is not read.
pub fn read(instances: &BTreeMap<u64, Instance>) -> Result<Model, String> {
    let named = |names: &[&str]| {
        let is = |instance: &Instance| {
            instance.iter().find(|(name, _)| names.contains(&name.as_str())).map(|(name, _)| name.clone())
        };
        instances.iter().find_map(|(number, instance)| is(instance).map(|name| (*number, name)))
    };
    if let Some((number, name)) = named(&ASSEMBLIES) {
        return Err(format!(
            "#{number} {name}: assemblies are not read; one part in its own coordinates was expected"
        ));
    }
    if let Some((number, name)) = named(&OTHER_GEOMETRY) {
        return Err(format!(
            "#{number} {name}: tessellated geometry is not read; ADVANCED_FACEs were expected"
        ));
    }
    let mut reader = Reader { instances, unit: 1.0, radian: 1.0 };
    (reader.unit, reader.radian) = reader.units()?;
    let mut model = Model { faces: Vec::new(), edges: BTreeMap::new() };
    for (number, instance) in instances {
        if instance.iter().any(|(name, _)| name == "ADVANCED_FACE" || name == "FACE_SURFACE") {
            let face = reader.face(*number, &mut model.edges)?;
            model.faces.push(face);
        }
    }
    if model.faces.is_empty() {
        return Err("the STEP file has no ADVANCED_FACE: a boundary representation was expected".to_owned());
    }
    Ok(model)
}

struct Reader<'a> {
    instances: &'a BTreeMap<u64, Instance>,
    /// Metres in a length, radians in a plane angle.
    unit: f64,
    radian: f64,
}

/// The parameters of one type of an instance.
#[derive(Clone, Copy)]
struct Record<'a> {
    number: u64,
    name: &'a str,
    values: &'a [Value],
}

impl<'a> Record<'a> {
    fn fail<T>(&self, text: &str) -> Result<T, String> {
        Err(format!("#{} {}: {text}", self.number, self.name))
    }

    fn value(&self, k: usize) -> Result<&'a Value, String> {
        match self.values.get(k) {
            Some(value) => Ok(value),
            None => self.fail(&format!("parameter {} is missing", k + 1)),
        }
    }

    fn reference(&self, k: usize) -> Result<u64, String> {
        match self.value(k)? {
            Value::Reference(number) => Ok(*number),
            _ => self.fail(&format!("parameter {} is no instance", k + 1)),
        }
    }

    fn references(&self, k: usize) -> Result<Vec<u64>, String> {
        let one = |value: &Value| match value {
            Value::Reference(number) => Ok(*number),
            _ => self.fail(&format!("parameter {} is no list of instances", k + 1)),
        };
        self.list(k)?.iter().map(one).collect()
    }

    fn list(&self, k: usize) -> Result<&'a [Value], String> {
        match self.value(k)? {
            Value::List(list) => Ok(list),
            _ => self.fail(&format!("parameter {} is no list", k + 1)),
        }
    }

    fn number(&self, k: usize) -> Result<f64, String> {
        self.as_number(self.value(k)?, k)
    }

    fn as_number(&self, value: &Value, k: usize) -> Result<f64, String> {
        match value {
            Value::Number(x) => Ok(*x),
            Value::Typed(_, inner) if inner.len() == 1 => self.as_number(&inner[0], k),
            _ => self.fail(&format!("parameter {} is no number", k + 1)),
        }
    }

    fn numbers(&self, k: usize) -> Result<Vec<f64>, String> {
        self.list(k)?.iter().map(|value| self.as_number(value, k)).collect()
    }

    fn flag(&self, k: usize) -> Result<bool, String> {
        match self.value(k)? {
            Value::Word(word) if word == "T" => Ok(true),
            Value::Word(word) if word == "F" => Ok(false),
            _ => self.fail(&format!("parameter {} is neither .T. nor .F.", k + 1)),
        }
    }

    fn count(&self, k: usize) -> Result<usize, String> {
        let x = self.number(k)?;
        if x >= 0.0 && x.fract() == 0.0 && x < 1e6 {
            Ok(x as usize)
        } else {
            self.fail(&format!("parameter {} is no count", k + 1))
        }
    }
}

impl<'a> Reader<'a> {
    fn instance(&self, number: u64) -> Result<&'a Instance, String> {
        self.instances.get(&number).ok_or_else(|| format!("#{number} is used and not there in the STEP file"))
    }

    /// The parameters of a type that an instance has, alone or among others.
    fn part(&self, number: u64, name: &str) -> Result<Option<Record<'a>>, String> {
        let found = self.instance(number)?.iter().find(|(own, _)| own == name);
        Ok(found.map(|(name, values)| Record { number, name, values }))
    }

    fn record(&self, number: u64, name: &str) -> Result<Record<'a>, String> {
        self.part(number, name)?
            .ok_or_else(|| format!("#{number} {}: {name} was expected", self.kind(number)))
    }

    /// The type of an instance, the types of a complex one.
    fn kind(&self, number: u64) -> String {
        let names =
            self.instances.get(&number).map(|instance| instance.iter().map(|(name, _)| name.as_str()));
        names.map(|names| names.collect::<Vec<_>>().join(" ")).unwrap_or_default()
    }

    /// Metres in a unit of length and radians in one of angles, of the file's contexts.
    fn units(&self) -> Result<(f64, f64), String> {
        let (mut length, mut angle) = (None, None);
        for number in self.instances.keys() {
            let Some(context) = self.part(*number, "GLOBAL_UNIT_ASSIGNED_CONTEXT")? else { continue };
            for unit in context.references(0)? {
                let slot = if self.part(unit, "LENGTH_UNIT")?.is_some() {
                    &mut length
                } else if self.part(unit, "PLANE_ANGLE_UNIT")?.is_some() {
                    &mut angle
                } else {
                    continue;
                };
                let factor = self.unit_factor(unit, 0)?;
                if slot.is_some_and(|other: f64| (other / factor - 1.0).abs() > 1e-9) {
                    return Err(format!(
                        "#{number}: the STEP file has contexts of different units; one was expected"
                    ));
                }
                *slot = Some(factor);
            }
        }
        let length = length.ok_or("the STEP file names no unit of length (GLOBAL_UNIT_ASSIGNED_CONTEXT)")?;
        Ok((length, angle.unwrap_or(1.0)))
    }

    /// Metres or radians in one of a unit that `depth` others are stated by.
    fn unit_factor(&self, number: u64, depth: usize) -> Result<f64, String> {
        self.check_depth(number, depth)?;
        if let Some(si) = self.part(number, "SI_UNIT")? {
            // In a complex instance the inherited dimensions are not repeated.
            let words: Vec<&Value> = si.values.iter().rev().take(2).collect();
            return match words.as_slice() {
                [Value::Word(name), prefix] if name == "METRE" || name == "RADIAN" => match prefix {
                    Value::None => Ok(1.0),
                    Value::Word(prefix) => match prefix.as_str() {
                        "MICRO" => Ok(1e-6),
                        "MILLI" => Ok(1e-3),
                        "CENTI" => Ok(1e-2),
                        "DECI" => Ok(1e-1),
                        _ => si.fail("this prefix is not read"),
                    },
                    _ => si.fail("its prefix cannot be read"),
                },
                _ => si.fail("metres or radians were expected"),
            };
        }
        let unit = self.record(number, "CONVERSION_BASED_UNIT")?;
        let factor = unit.reference(1)?;
        let Some((name, values)) = self.instance(factor)?.first() else {
            return unit.fail("its factor has no type");
        };
        let measure = Record { number: factor, name, values };
        let size = measure.number(0)? * self.unit_factor(measure.reference(1)?, depth + 1)?;
        if !(size > 0.0 && size.is_finite()) {
            return measure.fail("a positive factor was expected");
        }
        Ok(size)
    }

    fn check_depth(&self, number: u64, depth: usize) -> Result<(), String> {
        if depth < CHAIN_MAX {
            return Ok(());
        }
        Err(format!(
            "#{number} {}: it leads to itself, or over more than {CHAIN_MAX} others",
            self.kind(number)
        ))
    }

    fn point(&self, number: u64) -> Result<Point3<f64>, String> {
        let record = self.record(number, "CARTESIAN_POINT")?;
        let [x, y, z] = record.numbers(1)?[..] else { return record.fail("three coordinates were expected") };
        let p = Point3::new(x, y, z) * self.unit;
        if p.coords.amax() > COORDINATE_MAX {
            return record.fail(&format!(
                "it lies {:.0} m from the origin; at most {COORDINATE_MAX} m is allowed",
                p.coords.amax()
            ));
        }
        Ok(p)
    }

    fn direction(&self, number: u64) -> Result<Vector3<f64>, String> {
        let record = self.record(number, "DIRECTION")?;
        let unit = match record.numbers(1)?[..] {
            [x, y, z] => Vector3::new(x, y, z).try_normalize(0.0),
            _ => None,
        };
        unit.map_or_else(|| record.fail("three numbers, not all 0, were expected"), Ok)
    }

    fn frame(&self, number: u64) -> Result<Frame, String> {
        let record = self.record(number, "AXIS2_PLACEMENT_3D")?;
        let optional = |k: usize| match record.value(k)? {
            Value::None => Ok(None),
            _ => self.direction(record.reference(k)?).map(Some),
        };
        let origin = self.point(record.reference(1)?)?;
        let z = optional(2)?.unwrap_or_else(Vector3::z);
        let given = optional(3)?.unwrap_or_else(|| if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() });
        let Some(x) = (given - z * z.dot(&given)).try_normalize(1e-9) else {
            return record.fail("its two directions are parallel");
        };
        Ok(Frame { origin, axes: [x, z.cross(&x), z] })
    }

    /// A length, > 0.
    fn length(&self, record: &Record<'_>, k: usize) -> Result<f64, String> {
        let length = record.number(k)? * self.unit;
        if length > 0.0 && length < COORDINATE_MAX {
            Ok(length)
        } else {
            record.fail("a positive length was expected")
        }
    }

    fn face(&self, number: u64, edges: &mut BTreeMap<u64, Edge>) -> Result<Face, String> {
        let record = match self.part(number, "ADVANCED_FACE")? {
            Some(record) => record,
            None => self.record(number, "FACE_SURFACE")?,
        };
        let mut loops = Vec::new();
        for bound in record.references(1)? {
            let bound = match self.part(bound, "FACE_OUTER_BOUND")? {
                Some(bound) => bound,
                None => self.record(bound, "FACE_BOUND")?,
            };
            let ring = bound.reference(1)?;
            let mut uses = Vec::new();
            for used in self.record(ring, "EDGE_LOOP")?.references(1)? {
                let oriented = self.record(used, "ORIENTED_EDGE")?;
                let (edge, forward) = (oriented.reference(3)?, oriented.flag(4)?);
                if let Entry::Vacant(slot) = edges.entry(edge) {
                    slot.insert(self.edge(edge)?);
                }
                uses.push(Use { edge, forward });
            }
            loops.push(uses);
        }
        Ok(Face { number, shape: self.shape(record.reference(2)?)?, same_sense: record.flag(3)?, loops })
    }

    fn edge(&self, number: u64) -> Result<Edge, String> {
        let record = self.record(number, "EDGE_CURVE")?;
        let vertices = [record.reference(1)?, record.reference(2)?];
        let point = |vertex: u64| self.point(self.record(vertex, "VERTEX_POINT")?.reference(1)?);
        let ends = [point(vertices[0])?, point(vertices[1])?];
        Ok(Edge { curve: self.curve(record.reference(3)?, 0)?, vertices, ends, forward: record.flag(4)? })
    }

    /// A curve that `depth` others are stated by.
    fn curve(&self, number: u64, depth: usize) -> Result<Curve, String> {
        self.check_depth(number, depth)?;
        for name in ["SURFACE_CURVE", "SEAM_CURVE", "INTERSECTION_CURVE"] {
            if let Some(record) = self.part(number, name)? {
                return self.curve(record.reference(1)?, depth + 1);
            }
        }
        if self.part(number, "LINE")?.is_some() {
            return Ok(Curve::Line);
        }
        if let Some(circle) = self.part(number, "CIRCLE")? {
            return Ok(Curve::Ellipse(self.frame(circle.reference(1)?)?, [self.length(&circle, 2)?; 2]));
        }
        if let Some(ellipse) = self.part(number, "ELLIPSE")? {
            let axes = [self.length(&ellipse, 2)?, self.length(&ellipse, 3)?];
            return Ok(Curve::Ellipse(self.frame(ellipse.reference(1)?)?, axes));
        }
        let Some(own) = self.part(number, "B_SPLINE_CURVE_WITH_KNOTS")? else {
            return Err(format!(
                "#{number} {}: this kind of curve is not read; LINE, CIRCLE, ELLIPSE or B_SPLINE_CURVE_WITH_KNOTS was expected",
                self.kind(number)
            ));
        };
        // A complex instance has the general curve's parameters in a record of their own.
        let general = self.part(number, "B_SPLINE_CURVE")?;
        let (base, first, own_first) = general.map_or((own, 1, 6), |general| (general, 0, 0));
        let points: Vec<Point3<f64>> =
            base.references(first + 1)?.into_iter().map(|p| self.point(p)).collect::<Result<_, _>>()?;
        let weights = match self.part(number, "RATIONAL_B_SPLINE_CURVE")? {
            Some(record) => record.numbers(0)?,
            None => vec![1.0; points.len()],
        };
        if weights.len() != points.len() || weights.iter().any(|w| *w <= 0.0) {
            return own.fail("a positive weight for every control point was expected");
        }
        let knots = repeated(&own, [own_first, own_first + 1], points.len())?;
        let knots = Knots::new(base.count(first)?, knots, points.len()).or_else(|text| own.fail(&text))?;
        Ok(Curve::Spline(knots, points.iter().zip(&weights).map(|(p, w)| (p.coords * *w).push(*w)).collect()))
    }

    fn shape(&self, number: u64) -> Result<Shape, String> {
        let placed = |name: &str| {
            let record = self.part(number, name)?;
            record.map(|record| Ok((record, self.frame(record.reference(1)?)?))).transpose()
        };
        let placed = |name: &str| -> Result<Option<(Record<'a>, Frame)>, String> { placed(name) };
        if let Some((_, frame)) = placed("PLANE")? {
            return Ok(Shape::Plane(frame));
        }
        if let Some((record, frame)) = placed("CYLINDRICAL_SURFACE")? {
            return Ok(Shape::Revolved(
                frame,
                Profile::Straight { radius: self.length(&record, 2)?, slope: 0.0 },
            ));
        }
        if let Some((record, frame)) = placed("CONICAL_SURFACE")? {
            let slope = (record.number(3)? * self.radian).tan();
            let radius = record.number(2)? * self.unit;
            if radius < 0.0 || !(slope.abs() > 1e-9 && slope.abs() < 1e6) {
                return record.fail("a radius of 0 or more and an angle between 0° and 90° were expected");
            }
            return Ok(Shape::Revolved(frame, Profile::Straight { radius, slope }));
        }
        if let Some((record, frame)) = placed("SPHERICAL_SURFACE")? {
            return Ok(Shape::Revolved(
                frame,
                Profile::Round { centre: 0.0, radius: self.length(&record, 2)? },
            ));
        }
        if let Some((record, frame)) = placed("TOROIDAL_SURFACE")? {
            let (centre, radius) = (self.length(&record, 2)?, self.length(&record, 3)?);
            if radius >= centre {
                return record.fail("the tube's radius is not less than the ring's, so that it meets itself: this is not read");
            }
            return Ok(Shape::Revolved(frame, Profile::Round { centre, radius }));
        }
        self.spline(number).map(|net| Shape::Spline(Box::new(net)))
    }

    fn spline(&self, number: u64) -> Result<RationalNet, String> {
        let Some(own) = self.part(number, "B_SPLINE_SURFACE_WITH_KNOTS")? else {
            return Err(format!(
                "#{number} {}: this kind of surface is not read; PLANE, CYLINDRICAL_SURFACE, CONICAL_SURFACE, SPHERICAL_SURFACE, \
                 TOROIDAL_SURFACE or B_SPLINE_SURFACE_WITH_KNOTS was expected",
                self.kind(number)
            ));
        };
        let general = self.part(number, "B_SPLINE_SURFACE")?;
        let (base, first, own_first) = general.map_or((own, 1, 8), |general| (general, 0, 0));
        let weights = self.part(number, "RATIONAL_B_SPLINE_SURFACE")?;
        let weights = weights.map(|record| record.list(0)).transpose()?;
        let mut net = Vec::new();
        for (i, row) in base.list(first + 2)?.iter().enumerate() {
            let Value::List(row) = row else { return base.fail("a list of lists of points was expected") };
            let weights = match weights {
                None => None,
                Some(rows) => match rows.get(i) {
                    Some(Value::List(weights)) if weights.len() == row.len() => Some(weights),
                    _ => return own.fail("a weight for every control point was expected"),
                },
            };
            let point = |(j, value): (usize, &Value)| {
                let Value::Reference(point) = value else {
                    return base.fail("a list of lists of points was expected");
                };
                let weight = weights.map_or(Ok(1.0), |weights| own.as_number(&weights[j], 0))?;
                Ok((self.point(*point)?, weight))
            };
            net.push(row.iter().enumerate().map(point).collect::<Result<Vec<_>, String>>()?);
        }
        let columns = net.first().map_or(0, Vec::len);
        let knots = [
            repeated(&own, [own_first, own_first + 2], net.len())?,
            repeated(&own, [own_first + 1, own_first + 3], columns)?,
        ];
        let degrees = [base.count(first)?, base.count(first + 1)?];
        let net = RationalNet::new(degrees, knots, &net).or_else(|text| own.fail(&text))?;
        if net.collapses() {
            return own.fail("a side of it collapses into a point, which is not read");
        }
        Ok(net)
    }
}

/// The knots of `count` control points by the parameters of their multiplicities and values.
fn repeated(record: &Record<'_>, parameters: [usize; 2], count: usize) -> Result<Vec<f64>, String> {
    let (times, values) = (record.numbers(parameters[0])?, record.numbers(parameters[1])?);
    if times.len() != values.len() || times.iter().any(|n| n.fract() != 0.0 || *n < 1.0) {
        return record.fail("a multiplicity for every knot was expected");
    }
    // Before memory is taken: few bytes may state many knots.
    if times.iter().sum::<f64>() > (count + DEGREE_MAX + 1) as f64 {
        return record.fail(&format!("there are more knots than {count} control points can have"));
    }
    Ok(times.iter().zip(values).flat_map(|(n, knot)| vec![knot; *n as usize]).collect())
}
