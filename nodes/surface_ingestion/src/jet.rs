//! Exact first and second derivatives of a function of two variables, carried along with its value
//! (forward-mode automatic differentiation).

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A value with its derivatives by x and y up to the second order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    /// f
    pub value: f64,
    /// ∂f/∂x
    pub x: f64,
    /// ∂f/∂y
    pub y: f64,
    /// ∂²f/∂x²
    pub xx: f64,
    /// ∂²f/∂x∂y
    pub xy: f64,
    /// ∂²f/∂y²
    pub yy: f64,
}

impl Jet {
    /// A constant.
    pub fn constant(value: f64) -> Self {
        Self { value, x: 0.0, y: 0.0, xx: 0.0, xy: 0.0, yy: 0.0 }
    }

    /// The first variable at `value`.
    pub fn variable_x(value: f64) -> Self {
        Self { x: 1.0, ..Self::constant(value) }
    }

    /// The second variable at `value`.
    pub fn variable_y(value: f64) -> Self {
        Self { y: 1.0, ..Self::constant(value) }
    }

    /// Whether the value and all derivatives are finite.
    pub fn is_finite(&self) -> bool {
        [self.value, self.x, self.y, self.xx, self.xy, self.yy].iter().all(|v| v.is_finite())
    }

    fn is_constant(&self) -> bool {
        [self.x, self.y, self.xx, self.xy, self.yy].iter().all(|&v| v == 0.0)
    }

    /// g(f) by the chain rule, from g and its first two derivatives at f.
    pub fn chain(self, g: f64, g1: f64, g2: f64) -> Self {
        // A constant stays one: ∞·0 must not make sqrt(0) or 0^0.5 of a constant undefined.
        if self.is_constant() {
            return Self::constant(g);
        }
        Self {
            value: g,
            x: g1 * self.x,
            y: g1 * self.y,
            xx: g1 * self.xx + g2 * self.x * self.x,
            xy: g1 * self.xy + g2 * self.x * self.y,
            yy: g1 * self.yy + g2 * self.y * self.y,
        }
    }

    /// f^e as in Python: a whole exponent takes any base, a broken one only a base that is not negative (elsewhere
    /// NaN); an exponent that varies is exp(e·log f).
    pub fn power(self, e: Self) -> Self {
        if !e.is_constant() {
            let ln = self.value.ln();
            let log = self.chain(ln, self.value.recip(), -self.value.powi(-2));
            let product = log * e;
            let exp = product.value.exp();
            return product.chain(exp, exp, exp);
        }
        let n = e.value;
        let raise = |k: f64| {
            if k == k.trunc() && k.abs() < 1e9 { self.value.powi(k as i32) } else { self.value.powf(k) }
        };
        let term = |factor: f64, k: f64| if factor == 0.0 { 0.0 } else { factor * raise(k) };
        self.chain(raise(n), term(n, n - 1.0), term(n * (n - 1.0), n - 2.0))
    }
}

impl Add for Jet {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self {
            value: self.value + o.value,
            x: self.x + o.x,
            y: self.y + o.y,
            xx: self.xx + o.xx,
            xy: self.xy + o.xy,
            yy: self.yy + o.yy,
        }
    }
}

impl Neg for Jet {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, x: -self.x, y: -self.y, xx: -self.xx, xy: -self.xy, yy: -self.yy }
    }
}

impl Sub for Jet {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        self + -o
    }
}

impl Mul for Jet {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        let (a, b) = (self, o);
        Self {
            value: a.value * b.value,
            x: a.x * b.value + a.value * b.x,
            y: a.y * b.value + a.value * b.y,
            xx: a.xx * b.value + 2.0 * a.x * b.x + a.value * b.xx,
            xy: a.xy * b.value + a.x * b.y + a.y * b.x + a.value * b.xy,
            yy: a.yy * b.value + 2.0 * a.y * b.y + a.value * b.yy,
        }
    }
}

impl Div for Jet {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let r = o.value.recip();
        let mut quotient = self * o.chain(r, -r * r, 2.0 * r * r * r);
        // Rounded once, as a plain division is.
        quotient.value = self.value / o.value;
        quotient
    }
}
