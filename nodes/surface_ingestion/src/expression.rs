//! Formulas z = f(x, y) with the meaning they have in Python: `-x^2` is −(x²), `^` (or `**`) binds to the right and
//! takes a signed exponent, `log` is the natural logarithm, functions need their parentheses, nothing multiplies
//! unsaid. Parsed with `winnow`'s operator-precedence parser, evaluated with exact derivatives by [`Jet`].
//!
//! (`exmex`, the other candidate, reads −2^2 as 4 and 2^3^2 as 64, knows no `**`, no `1e-3` and no derivative of `abs`.)

use winnow::LocatingSlice;
use winnow::ascii::{alpha1, multispace0};
use winnow::combinator::{Infix, Prefix, alt, cut_err, delimited, dispatch, expression, fail, opt, preceded};
use winnow::error::{ContextError, ErrMode};
use winnow::prelude::*;
use winnow::stream::{Location, Stream};
use winnow::token::{any, take_while};

use crate::jet::Jet;

/// Longest formula that is read, characters.
const LENGTH_MAX: usize = 4000;
/// Most operators and parentheses in a formula: bounds the parser's recursion.
const OPERATORS_MAX: usize = 500;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Function {
    Sin,
    Cos,
    Tan,
    Exp,
    Sqrt,
    Abs,
    Log,
    Tanh,
    Sinh,
    Cosh,
}

const FUNCTIONS: [(&str, Function); 10] = [
    ("sin", Function::Sin),
    ("cos", Function::Cos),
    ("tan", Function::Tan),
    ("exp", Function::Exp),
    ("sqrt", Function::Sqrt),
    ("abs", Function::Abs),
    ("log", Function::Log),
    ("tanh", Function::Tanh),
    ("sinh", Function::Sinh),
    ("cosh", Function::Cosh),
];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Step {
    Constant(f64),
    X,
    Y,
    Negate,
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
    Call(Function),
}

/// A parsed formula.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    /// In postfix order.
    steps: Vec<Step>,
}

/// A formula's value at one place.
#[derive(Clone, Copy, Debug)]
pub struct Evaluated {
    /// Value and derivatives; not finite where the formula is not defined.
    pub jet: Jet,
    /// Changes between two places with a pole of odd order between them (the sign of a denominator, the branch of a tangent).
    pub branch: u64,
}

impl Expression {
    /// Reads a formula.
    ///
    /// # Errors
    /// One sentence that says what is wrong at which character.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.chars().count() > LENGTH_MAX {
            return Err(format!("it is longer than {LENGTH_MAX} characters"));
        }
        if text.chars().filter(|c| "+-*/^(".contains(*c)).count() > OPERATORS_MAX {
            return Err(format!("it has more than {OPERATORS_MAX} operators and parentheses"));
        }
        if text.trim().is_empty() {
            return Err("it is empty".to_owned());
        }
        check_names(text)?;
        let mut input = LocatingSlice::new(text);
        let steps = formula(&mut input).map_err(|_| syntax_error(text, input.current_token_start()))?;
        if !input.is_empty() {
            return Err(syntax_error(text, input.current_token_start()));
        }
        Ok(Self { steps })
    }

    /// The value at (x, y) with its derivatives.
    pub fn at(&self, x: f64, y: f64) -> Evaluated {
        let mut stack: Vec<Jet> = Vec::with_capacity(16);
        let mut branch = 0u64;
        let mut turn =
            |side: i64| branch = branch.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(side as u64);
        for step in &self.steps {
            // The parser leaves exactly the operands that each step takes.
            let mut pop = || stack.pop().unwrap_or(Jet::constant(f64::NAN));
            let result = match *step {
                Step::Constant(c) => Jet::constant(c),
                Step::X => Jet::variable_x(x),
                Step::Y => Jet::variable_y(y),
                Step::Negate => -pop(),
                Step::Call(function) => {
                    let a = pop();
                    if function == Function::Tan {
                        turn((a.value / std::f64::consts::PI + 0.5).floor() as i64);
                    }
                    call(function, a)
                }
                Step::Add | Step::Subtract | Step::Multiply | Step::Divide | Step::Power => {
                    let (b, a) = (pop(), pop());
                    match step {
                        Step::Add => a + b,
                        Step::Subtract => a - b,
                        Step::Multiply => a * b,
                        Step::Divide => {
                            turn(i64::from(b.value < 0.0));
                            a / b
                        }
                        _ => {
                            if b.value < 0.0 {
                                turn(i64::from(a.value < 0.0));
                            }
                            a.power(b)
                        }
                    }
                }
            };
            stack.push(result);
        }
        Evaluated { jet: stack.pop().unwrap_or(Jet::constant(f64::NAN)), branch }
    }
}

fn call(function: Function, a: Jet) -> Jet {
    let v = a.value;
    match function {
        Function::Sin => a.chain(v.sin(), v.cos(), -v.sin()),
        Function::Cos => a.chain(v.cos(), -v.sin(), -v.cos()),
        Function::Tan => {
            let t = v.tan();
            a.chain(t, 1.0 + t * t, 2.0 * t * (1.0 + t * t))
        }
        Function::Exp => a.chain(v.exp(), v.exp(), v.exp()),
        Function::Sqrt => {
            let s = v.sqrt();
            a.chain(s, 0.5 / s, -0.25 / (s * s * s))
        }
        Function::Abs => a.chain(v.abs(), if v < 0.0 { -1.0 } else { 1.0 }, 0.0),
        Function::Log => a.chain(v.ln(), v.recip(), -v.powi(-2)),
        Function::Tanh => {
            let t = v.tanh();
            a.chain(t, 1.0 - t * t, -2.0 * t * (1.0 - t * t))
        }
        Function::Sinh => a.chain(v.sinh(), v.cosh(), v.sinh()),
        Function::Cosh => a.chain(v.cosh(), v.sinh(), v.cosh()),
    }
}

/// Every name must be a known one: said before the grammar complains of what follows it.
fn check_names(text: &str) -> Result<(), String> {
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_alphanumeric() || c == '_' || c == '.') {
        let word = &rest[start..];
        let end = word.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '.')).unwrap_or(word.len());
        let name = &word[..end];
        let is_number = name.starts_with(|c: char| c.is_ascii_digit() || c == '.');
        let known = ["x", "y", "pi"].contains(&name) || FUNCTIONS.iter().any(|(f, _)| *f == name);
        if !is_number && !known {
            let functions: Vec<&str> = FUNCTIONS.iter().map(|(f, _)| *f).collect();
            return Err(format!(
                "the name '{name}' is unknown; known are x, y, pi and the functions {}",
                functions.join(", ")
            ));
        }
        rest = &word[end..];
    }
    Ok(())
}

fn syntax_error(text: &str, byte: usize) -> String {
    let byte = byte.min(text.len());
    let column = text[..byte].chars().count() + 1;
    match text[byte..].trim_start().chars().next() {
        None => "it ends where a number, a name or a closing parenthesis was expected".to_owned(),
        Some(c) => format!("there is a syntax error at character {column} ('{c}')"),
    }
}

type Input<'i> = LocatingSlice<&'i str>;
type Parsed = Result<Vec<Step>, ErrMode<ContextError>>;

fn formula(input: &mut Input<'_>) -> Parsed {
    use Infix::{Left, Right};
    expression(operand)
        // A sign binds looser than a power and tighter than a product: -x^2, 2^-1, 2*-x.
        .prefix(preceded(
            multispace0,
            stay(dispatch! {any;
                '-' => Prefix(12, |_: &mut _, a| Ok(then(a, Vec::new(), Step::Negate))),
                '+' => Prefix(12, |_: &mut _, a| Ok(a)),
                _ => fail,
            }),
        ))
        .infix(preceded(
            multispace0,
            alt((
                alt(("**", "^")).value(Right(14, |_: &mut _, a, b| Ok(then(a, b, Step::Power)))),
                dispatch! {any;
                    '+' => Left(5, |_: &mut _, a, b| Ok(then(a, b, Step::Add))),
                    '-' => Left(5, |_: &mut _, a, b| Ok(then(a, b, Step::Subtract))),
                    '*' => Left(7, |_: &mut _, a, b| Ok(then(a, b, Step::Multiply))),
                    '/' => Left(7, |_: &mut _, a, b| Ok(then(a, b, Step::Divide))),
                    _ => fail,
                },
            )),
        ))
        .parse_next(input)
        .and_then(|steps| multispace0.parse_next(input).map(|_: &str| steps))
}

fn then(mut a: Vec<Step>, b: Vec<Step>, step: Step) -> Vec<Step> {
    a.extend(b);
    a.push(step);
    a
}

fn operand(input: &mut Input<'_>) -> Parsed {
    delimited(multispace0, stay(alt((number, name, parenthesised))), multispace0).parse_next(input)
}

fn parenthesised(input: &mut Input<'_>) -> Parsed {
    preceded('(', cut_err((formula, stay(')')).map(|(steps, _)| steps))).parse_next(input)
}

/// The same parser, which leaves the input where it began when it does not match, so that an error names that place.
fn stay<'i, O>(
    mut parser: impl Parser<Input<'i>, O, ErrMode<ContextError>>,
) -> impl Parser<Input<'i>, O, ErrMode<ContextError>> {
    move |input: &mut Input<'i>| {
        let start = input.checkpoint();
        parser.parse_next(input).inspect_err(|error| {
            if matches!(error, ErrMode::Backtrack(_)) {
                input.reset(&start);
            }
        })
    }
}

fn name(input: &mut Input<'_>) -> Parsed {
    let word = alpha1.parse_next(input)?;
    if let Some((_, function)) = FUNCTIONS.iter().find(|(f, _)| *f == word) {
        let steps = preceded(multispace0, cut_err(parenthesised)).parse_next(input)?;
        return Ok(then(steps, Vec::new(), Step::Call(*function)));
    }
    match word {
        "x" => Ok(vec![Step::X]),
        "y" => Ok(vec![Step::Y]),
        "pi" => Ok(vec![Step::Constant(std::f64::consts::PI)]),
        _ => fail.parse_next(input),
    }
}

fn number(input: &mut Input<'_>) -> Parsed {
    fn digits<'i>(input: &mut Input<'i>) -> Result<&'i str, ErrMode<ContextError>> {
        take_while(1.., |c: char| c.is_ascii_digit()).parse_next(input)
    }
    let mantissa = alt(((digits, opt(('.', opt(digits)))).void(), ('.', digits).void()));
    (mantissa, opt((alt(('e', 'E')), opt(alt(('+', '-'))), digits)))
        .take()
        .try_map(|text: &str| text.parse::<f64>())
        .verify(|value: &f64| value.is_finite())
        .map(|value| vec![Step::Constant(value)])
        .parse_next(input)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn value(text: &str, x: f64, y: f64) -> f64 {
        Expression::parse(text).unwrap_or_else(|e| panic!("{text}: {e}")).at(x, y).jet.value
    }

    #[test]
    fn means_what_python_means() {
        for (text, expected) in [
            ("-2^2", -4.0),
            ("-2**2", -4.0),
            ("2^3^2", 512.0),
            ("2**3**2", 512.0),
            ("2^-1", 0.5),
            ("2^-1*3", 1.5),
            ("2*-3^2", -18.0),
            ("--2", 2.0),
            ("+-2", -2.0),
            ("7-3-2", 2.0),
            ("8/4/2", 1.0),
            ("2*-3", -6.0),
            ("2 - -2", 4.0),
            ("(-2)^2", 4.0),
            ("2^-2^2", 0.0625),
            ("-2^-2", -0.25),
            ("1e-3", 0.001),
            ("1.5E+2", 150.0),
            (".5+1.", 1.5),
            ("log(2.718281828459045)", 1.0),
            ("sin(pi/2)", 1.0),
            ("abs(-3)", 3.0),
            ("2*pi*x/100", 2.0 * std::f64::consts::PI * 25.0 / 100.0),
            ("x^2 - y", 621.0),
            ("tanh(0)+sinh(0)+cosh(0)+sqrt(4)+exp(0)+tan(0)+cos(0)", 5.0),
            (" ( x ) ", 25.0),
            ("0^0", 1.0),
            ("sqrt(0)", 0.0),
        ] {
            let got = value(text, 25.0, 4.0);
            assert!(
                (got - expected).abs() <= 1e-15 * expected.abs().max(1.0),
                "{text} = {got}, not {expected}"
            );
        }
    }

    #[test]
    fn errors_say_what_and_where() {
        for (text, part) in [
            ("", "empty"),
            ("   ", "empty"),
            ("z + 1", "'z' is unknown"),
            ("sin(x) + foo(y)", "'foo' is unknown"),
            ("__import__('os')", "'__import__' is unknown"),
            ("2x", "character 2 ('x')"),
            ("x y", "character 3 ('y')"),
            ("sin x", "character 5 ('x')"),
            ("(x", "ends where"),
            ("x)", "character 2 (')')"),
            ("x +", "ends where"),
            ("3 $ 4", "character 3 ('$')"),
            ("x.real", "'x.real' is unknown"),
            ("1.2.3", "character 4"),
            ("1e999", "syntax error"),
            ("sin()", "character 5 (')')"),
            ("(x y)", "character 4 ('y')"),
            ("x // y", "character 4 ('/')"),
            ("é", "'é' is unknown"),
        ] {
            let error = Expression::parse(text).expect_err(text);
            assert!(error.contains(part), "{text}: {error}");
        }
        assert!(Expression::parse(&"(".repeat(3000)).is_err());
        assert!(Expression::parse(&"-".repeat(3000)).is_err());
        let deep = format!("{}x{}", "(".repeat(499), ")".repeat(499));
        assert_eq!(value(&deep, 3.0, 0.0), 3.0);
    }

    #[test]
    fn derivatives_match_central_differences() {
        for text in [
            "3.6*sin(2*pi*x/100) + cos(pi*y/40)",
            "x^3*y - y**4/(1+x^2)",
            "exp(-x*y)*tanh(x-y)",
            "sqrt(x^2+y^2+1)*log(2+x)",
            "abs(x-3)^3 + tan(x/9)*sinh(y/3)/cosh(x/2)",
            "x^1.5 + 2^y + x^y",
            "(x-3)^-2",
        ] {
            let f = Expression::parse(text).unwrap();
            let (x, y, h) = (1.3, 0.7, 1e-4);
            let jet = f.at(x, y).jet;
            let v = |i: f64, j: f64| f.at(x + i * h, y + j * h).jet.value;
            let close =
                |a: f64, b: f64| assert!((a - b).abs() < 2e-6 * (1.0 + b.abs()), "{text}: {a} against {b}");
            close(jet.x, (v(1., 0.) - v(-1., 0.)) / (2. * h));
            close(jet.y, (v(0., 1.) - v(0., -1.)) / (2. * h));
            close(jet.xx, (v(1., 0.) - 2. * v(0., 0.) + v(-1., 0.)) / (h * h));
            close(jet.yy, (v(0., 1.) - 2. * v(0., 0.) + v(0., -1.)) / (h * h));
            close(jet.xy, (v(1., 1.) - v(1., -1.) - v(-1., 1.) + v(-1., -1.)) / (4. * h * h));
        }
    }

    #[test]
    fn poles_change_the_branch() {
        for text in ["1/(x-3)", "tan(x-3+pi/2)", "(x-3)^-1"] {
            let f = Expression::parse(text).unwrap();
            assert_ne!(f.at(2.9, 0.0).branch, f.at(3.1, 0.0).branch, "{text}");
            assert_eq!(f.at(2.8, 0.0).branch, f.at(2.9, 0.0).branch, "{text}");
        }
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[-+*/^()xy0-9. episnco]{0,40}") {
            if let Ok(f) = Expression::parse(&text) {
                let _ = f.at(0.5, -0.5);
            }
        }
    }
}
