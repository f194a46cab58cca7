//! Mean, deviation and range of counts.

/// A summary of many counts that does not depend on their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spread {
    /// How many counts.
    pub count: u64,
    /// Their sum.
    pub sum: u64,
    squares: u128,
    least: u64,
    /// The largest; 0 where there are none.
    pub max: u64,
}

impl Default for Spread {
    fn default() -> Self {
        Self { count: 0, sum: 0, squares: 0, least: u64::MAX, max: 0 }
    }
}

impl Spread {
    /// Adds a count.
    #[inline]
    pub fn note(&mut self, value: u64) {
        self.count += 1;
        self.sum += value;
        self.squares += u128::from(value) * u128::from(value);
        self.least = self.least.min(value);
        self.max = self.max.max(value);
    }

    /// Adds the counts of another.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
        self.least = self.least.min(other.least);
        self.max = self.max.max(other.max);
    }

    /// The smallest; 0 where there are none.
    #[must_use]
    pub fn min(&self) -> u64 {
        if self.count == 0 { 0 } else { self.least }
    }

    /// The mean; 0 where there are none.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.count.max(1) as f64
    }

    /// The standard deviation; 0 where there are none.
    #[must_use]
    pub fn standard_deviation(&self) -> f64 {
        let count = u128::from(self.count.max(1));
        // n Σx² - (Σx)², exactly: never negative.
        let spread = count * self.squares - u128::from(self.sum) * u128::from(self.sum);
        (spread as f64).sqrt() / count as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[u64]) -> Spread {
        let mut spread = Spread::default();
        values.iter().for_each(|value| spread.note(*value));
        spread
    }

    #[test]
    fn counts_are_summed_up_in_any_order() {
        let all = of(&[2, 4, 4, 4, 5, 5, 7, 9]);
        assert_eq!((all.mean(), all.standard_deviation(), all.min(), all.max), (5.0, 2.0, 2, 9));
        let mut parts = of(&[9, 4, 5]);
        parts.add(&of(&[]));
        parts.add(&of(&[4, 7, 5, 2, 4]));
        assert_eq!(parts, all);
        let none = of(&[]);
        assert_eq!(
            (none.mean(), none.standard_deviation(), none.min(), none.max),
            (0.0, 0.0, 0, 0)
        );
        assert_eq!(of(&[1 << 40; 3]).standard_deviation(), 0.0);
    }
}
