//! B-spline basis functions over a knot vector, with their first and second derivatives.
//!
//! By de Boor and Cox: Nᵢ,₀ is 1 on [tᵢ, tᵢ₊₁), Nᵢ,ₚ(t) = (t − tᵢ)/(tᵢ₊ₚ − tᵢ)·Nᵢ,ₚ₋₁ + (tᵢ₊ₚ₊₁ − t)/(tᵢ₊ₚ₊₁ − tᵢ₊₁)·Nᵢ₊₁,ₚ₋₁, and
//! N′ᵢ,ₚ = p·(Nᵢ,ₚ₋₁/(tᵢ₊ₚ − tᵢ) − Nᵢ₊₁,ₚ₋₁/(tᵢ₊ₚ₊₁ − tᵢ₊₁)) (Piegl and Tiller, *The NURBS Book*, equations 2.5 and 2.7).

/// Highest degree.
pub const DEGREE_MAX: usize = 24;

/// One number for each basis function that is not zero on a span.
type Row = [f64; DEGREE_MAX + 1];

/// A knot vector and its degree. The functions make a partition of unity on [`Knots::domain`].
#[derive(Clone, Debug, PartialEq)]
pub struct Knots {
    degree: usize,
    knots: Vec<f64>,
}

/// The basis functions that are not zero at a parameter.
pub struct Basis {
    /// Index of the first of them.
    pub first: usize,
    degree: usize,
    /// Values, first and second derivatives.
    rows: [Row; 3],
}

impl Basis {
    /// The functions' derivatives of `order` 0, 1 or 2.
    pub fn of_order(&self, order: usize) -> &[f64] {
        &self.rows[order][..=self.degree]
    }
}

impl Knots {
    /// A knot vector of `degree` for `count` control points.
    ///
    /// # Errors
    /// Saying what is wrong: the degree, the number of knots, their order, a domain without length, more equal knots than a
    /// continuous surface has.
    pub fn new(degree: usize, knots: Vec<f64>, count: usize) -> Result<Self, String> {
        if !(1..=DEGREE_MAX).contains(&degree) {
            return Err(format!("the degree is {degree}; 1 to {DEGREE_MAX} was expected"));
        }
        if count <= degree {
            return Err(format!(
                "there are {count} control points; degree {degree} needs {} or more",
                degree + 1
            ));
        }
        if knots.len() != count + degree + 1 {
            return Err(format!(
                "there are {} knots; {count} control points of degree {degree} need {}",
                knots.len(),
                count + degree + 1
            ));
        }
        if let Some(i) = (1..knots.len()).find(|i| knots[*i] < knots[i - 1]) {
            return Err(format!(
                "knot {} is {}, less than the one before it, {}",
                i + 1,
                knots[i],
                knots[i - 1]
            ));
        }
        let this = Self { degree, knots };
        let [low, high] = this.domain();
        if low >= high || !(high - low).is_finite() {
            return Err(format!("the knots' domain {low} to {high} is empty"));
        }
        let repeated = this.inner().find(|(_, times)| *times > degree);
        repeated.map_or(Ok(this), |(knot, times)| {
            Err(format!(
                "the knot {knot} occurs {times} times; within the domain degree {degree} allows {degree}"
            ))
        })
    }

    /// First and last parameter.
    pub fn domain(&self) -> [f64; 2] {
        [self.knots[self.degree], self.knots[self.knots.len() - 1 - self.degree]]
    }

    /// Degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The different knots within the domain, its ends excluded, and how often each occurs.
    pub fn inner(&self) -> impl Iterator<Item = (f64, usize)> {
        let [low, high] = self.domain();
        self.knots
            .chunk_by(|a, b| a == b)
            .map(|same| (same[0], same.len()))
            .filter(move |(knot, _)| low < *knot && *knot < high)
    }

    /// The functions at `t`, held within the domain; at a knot those of the span after it, at the domain's end before it.
    pub fn at(&self, t: f64) -> Basis {
        let [low, high] = self.domain();
        let (least, most) = (self.degree, self.knots.len() - 2 - self.degree);
        let after = self.knots.partition_point(|knot| *knot <= t).saturating_sub(1).clamp(least, most);
        // The last span that is not empty, where knots repeat at the end.
        let span = (least..=after).rev().find(|i| self.knots[*i] < self.knots[i + 1]).unwrap_or(after);
        self.on_span(span, t.clamp(low, high))
    }

    /// The functions at an inner knot as of the span before it.
    pub fn before(&self, knot: f64) -> Basis {
        self.on_span(
            self.knots.partition_point(|other| *other < knot).saturating_sub(1).max(self.degree),
            knot,
        )
    }

    fn on_span(&self, span: usize, t: f64) -> Basis {
        let mut rows = [[0.0; DEGREE_MAX + 1]; 3];
        let (mut row, mut slope) = ([0.0; DEGREE_MAX + 1], [0.0; DEGREE_MAX + 1]);
        row[0] = 1.0;
        for degree in 1..=self.degree {
            rows[2] = self.differentiated(span, degree, &slope);
            slope = self.differentiated(span, degree, &row);
            row = self.raised(span, degree, &row, t);
        }
        (rows[0], rows[1]) = (row, slope);
        Basis { first: span - self.degree, degree: self.degree, rows }
    }

    /// Values of degree `degree` on a span by those of one degree less.
    fn raised(&self, span: usize, degree: usize, row: &Row, t: f64) -> Row {
        let mut next = [0.0; DEGREE_MAX + 1];
        for k in 0..degree {
            // Function k of one degree less is not zero from this knot to that one.
            let (from, to) = (self.knots[span + 1 + k - degree], self.knots[span + 1 + k]);
            let share = row[k] / (to - from);
            next[k] += (to - t) * share;
            next[k + 1] += (t - from) * share;
        }
        next
    }

    /// Derivatives of degree `degree` on a span by the values (or derivatives) of one degree less.
    fn differentiated(&self, span: usize, degree: usize, row: &Row) -> Row {
        let mut next = [0.0; DEGREE_MAX + 1];
        for k in 0..degree {
            let (from, to) = (self.knots[span + 1 + k - degree], self.knots[span + 1 + k]);
            let share = degree as f64 * row[k] / (to - from);
            next[k] -= share;
            next[k + 1] += share;
        }
        next
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn each_bad_vector_is_one_clear_error() {
        for (degree, knots, count, words) in [
            (0, vec![0.0, 1.0], 1, "degree is 0"),
            (25, vec![0.0; 60], 30, "degree is 25"),
            (3, vec![0.0; 8], 3, "needs 4"),
            (1, vec![0.0, 0.0, 1.0], 2, "need 4"),
            (1, vec![0.0, 0.0, 1.0, 0.5], 2, "knot 4 is 0.5"),
            (1, vec![1.0; 4], 2, "empty"),
            (1, vec![0.0, f64::NAN, f64::NAN, 1.0], 2, "empty"),
            (1, vec![0.0, 0.0, 1.0, 1.0, 2.0, 2.0], 4, "occurs 2 times"),
        ] {
            let text = Knots::new(degree, knots, count).unwrap_err();
            assert!(text.contains(words), "{words}: {text}");
        }
    }

    #[test]
    fn a_knot_belongs_to_the_span_after_it() {
        let knots = Knots::new(1, vec![0.0, 0.0, 1.0, 2.0, 2.0], 3).unwrap();
        assert_eq!((knots.at(1.0).first, knots.before(1.0).first, knots.at(2.0).first), (1, 0, 1));
        assert_eq!(knots.before(1.0).of_order(0), [0.0, 1.0]);
        assert_eq!(knots.at(7.0).of_order(0), [0.0, 1.0]);
    }

    proptest! {
        /// The control values of tᵖ are its polar form at p following knots: here as (1 + t)ᵖ, by independent means.
        #[test]
        fn powers_are_reproduced_with_their_derivatives(
            degree in 2usize..8,
            steps in prop::collection::vec(prop_oneof![Just(0.0), 0.1..1.0f64], 12),
            at in 0.0..1.0f64,
        ) {
            let mut inner: Vec<f64> = steps.iter().scan(0.0, |sum, step| { *sum += step; Some(*sum) }).collect();
            inner.dedup_by(|a, b| a == b && degree < 4);
            let end = inner.last().copied().unwrap_or(0.0) + 1.0;
            let mut knots = vec![0.0; degree + 1];
            knots.extend(inner.iter().filter(|t| **t > 0.0));
            knots.extend(vec![end; degree + 1]);
            let count = knots.len() - degree - 1;
            let made = Knots::new(degree, knots.clone(), count);
            prop_assume!(made.is_ok());
            let control: Vec<f64> = (0..count).map(|i| knots[i + 1..=i + degree].iter().map(|t| 1.0 + t).product()).collect();
            let (t, p) = (at * end, degree as f64);
            let basis = made.unwrap().at(t);
            let sum = |order: usize| -> f64 {
                basis.of_order(order).iter().enumerate().map(|(k, n)| n * control[basis.first + k]).sum()
            };
            let size = (1.0 + end).powi(degree as i32) * p * p;
            prop_assert!((sum(0) - (1.0 + t).powf(p)).abs() < 1e-12 * size);
            prop_assert!((sum(1) - p * (1.0 + t).powf(p - 1.0)).abs() < 1e-11 * size);
            prop_assert!((sum(2) - p * (p - 1.0) * (1.0 + t).powf(p - 2.0)).abs() < 1e-10 * size);
        }
    }
}
