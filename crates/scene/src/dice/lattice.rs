//! The lattices that cut a triangle, or a rectangle of two, into micropolygons: rectangles and triangles.

use pbgi_math::DVec3;

/// Most steps along one edge; keeps every product of two step counts below 2⁶².
const STEPS_MAX: u64 = 1 << 31;

/// Steps are rounded up, but a length this little above a whole number of steps does not take one
/// more: equal edges of neighboring triangles, unequal by rounding, take equal steps.
const STEP_SLACK: f64 = 1e-3;

/// Largest cosine of an angle that is taken for a right one: its rectangles are off by half a hundredth of their edges.
pub(super) const SKEW_COSINE_MAX: f64 = 0.01;

/// Most a cell's long edge measures in short edges; where this needs more steps along the long edge, they are added.
const ASPECT_MAX: f64 = 1.5;

/// ... but not so many that they are shorter than this share of the spacing.
const SPACING_SHARE_MIN: f64 = 0.25;

/// A corner of a piece of a triangle, or a step between two.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Corner {
    pub position: DVec3,
    pub barycentric: DVec3,
}

/// How a piece is cut.
#[derive(Clone, Copy, Debug, Default)]
enum Cut {
    /// Not at all: a triangle.
    #[default]
    Whole,
    /// A rectangle, into rows of equal rectangles: steps along `u` and `v`.
    Rectangle { u_steps: u64, v_steps: u64 },
    /// A right triangle, into strips of a step along `u`; each ends in a triangle of a step of `u` and one of `v`, which lie on the
    /// third edge without a rest. What is below is cut into equal rectangles of at most `rise` steps of `v`.
    RightTriangle { steps: u64, rise: u64 },
}

/// A triangle, a right one, or a rectangle, cut into micropolygons.
///
/// The steps `u` and `v` lead from the first corner along the two edges there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lattice {
    origin: Corner,
    u: Corner,
    v: Corner,
    cut: Cut,
}

/// One micropolygon: what two edges span from a corner, or the half of it with that corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    corner: Corner,
    edges: [Corner; 2],
    pub is_triangle: bool,
}

/// A triangle or rectangle as one or two lattices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattices {
    pub pieces: [Lattice; 2],
    pub piece_count: usize,
}

impl Lattices {
    /// Dices the triangle `positions` with steps of at most `spacing`. One that is larger is first split by the height
    /// on its longest edge, if it has no right angle.
    pub fn new(positions: [DVec3; 3], spacing: f64) -> Self {
        let corner = |i: usize| Corner::of_triangle(positions, i);
        // The largest angle is opposite the longest edge.
        let opposite = |i: usize| positions[(i + 1) % 3].distance_squared(positions[(i + 2) % 3]);
        let apex = (1..3).fold(0, |best, i| if opposite(i) > opposite(best) { i } else { best });
        let [a, b, c] = [corner(apex), corner(apex + 1), corner(apex + 2)];
        let one = |piece| Self { pieces: [piece, Lattice::default()], piece_count: 1 };
        if count_steps(b.position.distance(c.position), spacing) == 1 {
            return one(Lattice::whole([a, b, c]));
        }
        let (ab, ac) = (b.position - a.position, c.position - a.position);
        if ab.dot(ac).abs() <= SKEW_COSINE_MAX * (ab.length_squared() * ac.length_squared()).sqrt()
        {
            return one(Lattice::right_triangle([a, b, c], spacing));
        }
        let bc = c.position - b.position;
        let foot = b.lerp(c, (-ab.dot(bc) / bc.length_squared()).clamp(0.0, 1.0));
        let pieces = [[foot, a, b], [foot, c, a]].map(|p| Lattice::right_triangle(p, spacing));
        Self { pieces, piece_count: 2 }
    }

    /// Dices the rectangle over the edges from corner `apex` of the triangle `positions`.
    /// Barycentric coordinates beyond the triangle are outside 0..=1.
    pub fn of_rectangle(positions: [DVec3; 3], apex: usize, spacing: f64) -> Self {
        let [a, b, c] = [0, 1, 2].map(|k| Corner::of_triangle(positions, apex + k));
        let lengths = [a.position.distance(b.position), a.position.distance(c.position)];
        let [u_steps, v_steps] = count_lattice_steps(lengths, spacing);
        let whole = Lattice {
            origin: a,
            u: a.step_to(b, u_steps),
            v: a.step_to(c, v_steps),
            cut: Cut::Rectangle { u_steps, v_steps },
        };
        Self { pieces: [whole, Lattice::default()], piece_count: 1 }
    }

    /// The lattices there are.
    pub fn pieces(&self) -> &[Lattice] {
        &self.pieces[..self.piece_count]
    }

    /// Micropolygons of the triangle or rectangle.
    pub fn cell_count(&self) -> u64 {
        self.pieces().iter().map(Lattice::cell_count).sum()
    }
}

impl Corner {
    /// Corner `i`, modulo 3.
    fn of_triangle(positions: [DVec3; 3], i: usize) -> Self {
        Self {
            position: positions[i % 3],
            barycentric: DVec3::from_array(std::array::from_fn(|k| {
                f64::from(u8::from(k == i % 3))
            })),
        }
    }

    fn lerp(self, other: Self, t: f64) -> Self {
        Self {
            position: self.position.lerp(other.position, t),
            barycentric: self.barycentric.lerp(other.barycentric, t),
        }
    }

    /// A step of so many to another corner.
    fn step_to(self, other: Self, steps: u64) -> Self {
        Self {
            position: (other.position - self.position) / steps as f64,
            barycentric: (other.barycentric - self.barycentric) / steps as f64,
        }
    }

    /// So many steps from here.
    #[inline]
    fn step(self, step: &Self, count: f64) -> Self {
        Self {
            position: self.position + step.position * count,
            barycentric: self.barycentric + step.barycentric * count,
        }
    }

    /// A share of a step.
    fn share(self, share: f64) -> Self {
        Self { position: self.position * share, barycentric: self.barycentric * share }
    }
}

impl Lattice {
    fn whole([a, b, c]: [Corner; 3]) -> Self {
        Self { origin: a, u: a.step_to(b, 1), v: a.step_to(c, 1), cut: Cut::Whole }
    }

    /// With the right angle at the first corner.
    fn right_triangle([a, b, c]: [Corner; 3], spacing: f64) -> Self {
        let length = |to: &Corner| a.position.distance(to.position);
        // Strips across the longer leg.
        let (long, short) = if length(&b) >= length(&c) { (b, c) } else { (c, b) };
        let [steps, short_steps] = count_lattice_steps([length(&long), length(&short)], spacing);
        let rise = (steps / short_steps).max(1);
        Self {
            origin: a,
            u: a.step_to(long, steps),
            v: a.step_to(short, steps),
            cut: Cut::RightTriangle { steps, rise },
        }
    }

    /// Micropolygons.
    pub fn cell_count(&self) -> u64 {
        match self.cut {
            Cut::Whole => 1,
            Cut::Rectangle { u_steps, v_steps } => u_steps * v_steps,
            // Σ ⌈j / rise⌉ for j below `steps`: `rise` of each number, and the rest of the last.
            Cut::RightTriangle { steps, rise } => {
                let (full, rest) = ((steps - 1) / rise, (steps - 1) % rise);
                steps + rise * (full * (full + 1) / 2) + rest * (full + 1)
            }
        }
    }

    /// Whether any of its cells are rectangles.
    pub fn has_rectangles(&self) -> bool {
        match self.cut {
            Cut::Whole => false,
            Cut::Rectangle { .. } => true,
            Cut::RightTriangle { steps, .. } => steps > 1,
        }
    }

    /// Number of rows.
    pub fn row_count(&self) -> u64 {
        match self.cut {
            Cut::Whole => 1,
            Cut::Rectangle { v_steps, .. } => v_steps,
            Cut::RightTriangle { steps, .. } => steps,
        }
    }

    /// Cells of `row`.
    pub fn column_count(&self, row: u64) -> u64 {
        match self.cut {
            Cut::Whole => 1,
            Cut::Rectangle { u_steps, .. } => u_steps,
            Cut::RightTriangle { steps, rise } => (steps - 1 - row).div_ceil(rise) + 1,
        }
    }

    /// Cell (column, row).
    #[inline]
    pub fn cell(&self, column: u64, row: u64) -> Cell {
        let at = |u: f64, v: f64| self.origin.step(&self.u, u).step(&self.v, v);
        let cell = |corner, edges, is_triangle| Cell { corner, edges, is_triangle };
        match self.cut {
            Cut::Whole => cell(self.origin, [self.u, self.v], true),
            Cut::Rectangle { .. } => cell(at(column as f64, row as f64), [self.u, self.v], false),
            Cut::RightTriangle { steps, rise } => {
                let below = (steps - 1 - row) as f64;
                let pieces = (steps - 1 - row).div_ceil(rise);
                if column >= pieces {
                    return cell(at(row as f64, below), [self.u, self.v], true);
                }
                let height = below / pieces as f64;
                let corner = at(row as f64, height * column as f64);
                cell(corner, [self.u, self.v.share(height)], false)
            }
        }
    }
}

impl Cell {
    /// Steps from the corner to the centroid.
    fn middle(&self) -> f64 {
        if self.is_triangle { 1.0 / 3.0 } else { 0.5 }
    }

    /// Centroid.
    #[inline]
    pub fn center(&self) -> DVec3 {
        let [u, v] = &self.edges;
        self.corner.position + (u.position + v.position) * self.middle()
    }

    /// Barycentric coordinates of the centroid in the whole triangle.
    #[inline]
    pub fn barycentric(&self) -> DVec3 {
        let [u, v] = &self.edges;
        self.corner.barycentric + (u.barycentric + v.barycentric) * self.middle()
    }

    /// The edges from its corner.
    #[inline]
    pub fn edges(&self) -> [DVec3; 2] {
        self.edges.map(|edge| edge.position)
    }

    /// Area; of a rectangle whose angles are nearly right, exactly.
    #[inline]
    pub fn area(&self) -> f64 {
        let [u, v] = self.edges();
        u.cross(v).length() * if self.is_triangle { 0.5 } else { 1.0 }
    }

    /// The longest edge of a triangle, such that the third corner lies to its left, seen against this normal; and over which share of it.
    pub fn base(&self, normal: DVec3) -> (DVec3, f64) {
        let [u, v] = self.edges();
        let [a, b, c] = match normal.dot(u.cross(v)) > 0.0 {
            true => [DVec3::ZERO, u, v],
            false => [DVec3::ZERO, v, u],
        };
        let edges = [(a, b, c), (b, c, a), (c, a, b)];
        let longer = |best: (DVec3, DVec3, DVec3), edge: (DVec3, DVec3, DVec3)| {
            if (edge.1 - edge.0).length_squared() > (best.1 - best.0).length_squared() {
                edge
            } else {
                best
            }
        };
        let (from, to, apex) = edges.into_iter().fold(edges[0], longer);
        let base = to - from;
        (base, (apex - from).dot(base) / base.length_squared())
    }

    /// The four like it of half the size. The last part of a triangle lies amid the others, turned by half a circle.
    pub fn parts(&self) -> [Self; 4] {
        let [u, v] = self.edges.map(|edge| edge.share(0.5));
        let part = |x: f64, y: f64, edges| Self {
            corner: self.corner.step(&u, x).step(&v, y),
            edges,
            ..*self
        };
        let last = if self.is_triangle { [u, v].map(|edge| edge.share(-1.0)) } else { [u, v] };
        [
            part(0.0, 0.0, [u, v]),
            part(1.0, 0.0, [u, v]),
            part(0.0, 1.0, [u, v]),
            part(1.0, 1.0, last),
        ]
    }

    /// Whether it is turned by half a circle against `other`, of whose lattice it is.
    pub fn is_turned(&self, other: DVec3) -> bool {
        self.edges[0].position.dot(other) < 0.0
    }

    /// Barycentric coordinates of the corners of the rectangle that it is, or is the half of.
    pub fn corners(&self) -> [DVec3; 4] {
        let [u, v] = self.edges.map(|edge| edge.barycentric);
        let corner = self.corner.barycentric;
        [corner, corner + u, corner + v, corner + u + v]
    }

    /// Calls `visit` with the barycentric coordinates of the middles of equal parts of the cell: `edge` × `edge` of a rectangle, and about as many for its
    /// area of a triangle.
    #[inline]
    pub fn visit_grid(&self, edge: u32, mut visit: impl FnMut(DVec3)) {
        let edge = if self.is_triangle { (3 * edge).div_ceil(4) } else { edge };
        let [u, v] = self.edges.map(|step| step.barycentric);
        let part = 1.0 / f64::from(edge);
        for row in 0..edge {
            for column in 0..edge {
                let (x, y) = match (self.is_triangle, row + column < edge) {
                    (false, _) => (f64::from(column) + 0.5, f64::from(row) + 0.5),
                    (true, true) => (f64::from(column) + 1.0 / 3.0, f64::from(row) + 1.0 / 3.0),
                    // Of the rectangle's other half: the turned parts between these.
                    (true, false) => {
                        (f64::from(edge - column) - 1.0 / 3.0, f64::from(edge - row) - 1.0 / 3.0)
                    }
                };
                visit(self.corner.barycentric + u * (x * part) + v * (y * part));
            }
        }
    }
}

/// Steps of at most `spacing` (give or take [`STEP_SLACK`]) along `length`, at least 1.
fn count_steps(length: f64, spacing: f64) -> u64 {
    // A float cast saturates, and takes what is not a number to 0.
    ((length / spacing - STEP_SLACK).ceil() as u64).clamp(1, STEPS_MAX)
}

/// Steps along the two edges of a lattice: at most `spacing` long, and more along the edge where they would be too long for
/// the steps along the other.
fn count_lattice_steps(lengths: [f64; 2], spacing: f64) -> [u64; 2] {
    let steps = lengths.map(|length| count_steps(length, spacing));
    std::array::from_fn(|k| {
        let other = lengths[1 - k] / steps[1 - k] as f64;
        // A float cast saturates, and takes what is not a number to 0.
        let most = (lengths[k] / (SPACING_SHARE_MIN * spacing) + STEP_SLACK) as u64;
        let wanted = count_steps(lengths[k], ASPECT_MAX * other);
        wanted.min(most).clamp(steps[k], STEPS_MAX)
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Calls `visit` with every cell of a triangle.
    fn visit_cells(lattices: &Lattices, mut visit: impl FnMut(&Cell)) {
        for lattice in lattices.pieces() {
            for row in 0..lattice.row_count() {
                for column in 0..lattice.column_count(row) {
                    visit(&lattice.cell(column, row));
                }
            }
        }
    }

    /// A splitmix64 sequence in 0..1.
    pub fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    fn random_triangle(next: &mut impl FnMut() -> f64) -> [DVec3; 3] {
        let mut point = || DVec3::new(next(), next(), next()) * 4.0;
        let [a, b, c] = [point(), point(), point()];
        // Every other one is a needle.
        if next() < 0.5 { [a, b, c] } else { [a, b, a.lerp(b, next()) + (c - a) * 1e-4] }
    }

    #[test]
    fn cells_tile_every_triangle() {
        let mut next = random(1);
        for _ in 0..400 {
            let t = random_triangle(&mut next);
            let area = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length();
            let centroid = (t[0] + t[1] + t[2]) / 3.0;
            let lattices = Lattices::new(t, 0.05 + 3.0 * next());
            let (mut sum, mut moment, mut count) = (0.0, DVec3::ZERO, 0);
            visit_cells(&lattices, |cell| {
                assert!(cell.area() > 0.0);
                let b = cell.barycentric();
                assert!(b.min_element() > -1e-12 && (b.element_sum() - 1.0).abs() < 1e-12);
                assert!((t[0] * b.x + t[1] * b.y + t[2] * b.z - cell.center()).length() < 1e-11);
                sum += cell.area();
                moment += cell.center() * cell.area();
                count += 1;
            });
            assert!((sum / area - 1.0).abs() < 1e-8, "{sum} {area} {t:?}");
            assert!((moment / sum - centroid).length() < 1e-6);
            assert_eq!(count, lattices.cell_count());
        }
    }

    #[test]
    fn every_point_is_in_one_cell() {
        let mut next = random(2);
        for _ in 0..300 {
            let t = random_triangle(&mut next);
            let mut cells = vec![];
            visit_cells(&Lattices::new(t, 0.3 + next()), |cell| cells.push(*cell));
            for _ in 0..100 {
                let (mut x, mut y) = (next(), next());
                if x + y > 1.0 {
                    (x, y) = (1.0 - x, 1.0 - y);
                }
                let point = t[0] + (t[1] - t[0]) * x + (t[2] - t[0]) * y;
                let holds = |cell: &&Cell| {
                    let [u, v] = cell.edges();
                    let (n, d) = (u.cross(v), point - cell.corner.position);
                    let x = d.cross(v).dot(n) / n.length_squared();
                    let y = u.cross(d).dot(n) / n.length_squared();
                    let most = if cell.is_triangle { x + y } else { x.max(y) };
                    x.min(y) >= 0.0 && most <= 1.0
                };
                // Of random points none lies on an edge.
                assert_eq!(cells.iter().filter(holds).count(), 1, "{point} of {t:?}");
            }
        }
    }

    #[test]
    fn parts_tile_their_cell() {
        let mut next = random(5);
        for _ in 0..100 {
            let t = random_triangle(&mut next);
            visit_cells(&Lattices::new(t, 0.5 + next()), |cell| {
                let parts = cell.parts();
                let area: f64 = parts.iter().map(Cell::area).sum();
                assert!((area / cell.area() - 1.0).abs() < 1e-6);
                let moment = parts.iter().fold(DVec3::ZERO, |sum, p| sum + p.center() * p.area());
                assert!((moment / area - cell.center()).length() < 1e-6);
                for (i, part) in parts.iter().enumerate() {
                    assert_eq!(part.is_turned(cell.edges()[0]), cell.is_triangle && i == 3);
                    let within = |b: DVec3| b.min_element() > -1e-9;
                    let (mut count, mut sum) = (0, DVec3::ZERO);
                    part.visit_grid(8, |b| {
                        assert!(within(b), "{b}");
                        (count, sum) = (count + 1, sum + b);
                    });
                    let off = sum / f64::from(count) - part.barycentric();
                    let all = if part.is_triangle { 36 } else { 64 };
                    assert!(count == all && off.length() < 1e-6, "{off} of {count}");
                }
            });
        }
    }

    #[test]
    fn angles_are_right_and_edges_no_longer_than_the_spacing() {
        let mut next = random(3);
        for _ in 0..300 {
            let (spacing, t) = (0.1 + next(), random_triangle(&mut next));
            visit_cells(&Lattices::new(t, spacing), |cell| {
                let [u, v] = cell.edges();
                let (base, foot) = cell.base(u.cross(v).normalize());
                if !cell.is_triangle || base.length() > spacing * 1.01 {
                    let cosine = u.dot(v) / (u.length() * v.length());
                    assert!(cosine.abs() < 0.011, "{cosine} of {t:?}");
                }
                assert!(u.length().max(v.length()) < spacing * 1.01);
                if cell.is_triangle {
                    assert!((-1e-9..=1.0 + 1e-9).contains(&foot), "{foot} of {t:?}");
                    let height = 2.0 * cell.area() / base.length();
                    let left = u.cross(v).normalize().cross(base).normalize();
                    let apex = base * foot + left * height;
                    // The two other edges.
                    let lengths = [apex.length(), (apex - base).length()];
                    let of_cell = [u.length(), v.length(), (u - v).length()];
                    for length in lengths {
                        assert!(of_cell.iter().any(|l| (l / length - 1.0).abs() < 1e-6));
                    }
                }
            });
        }
    }

    #[test]
    fn long_cells_are_cut_but_not_below_a_quarter_of_the_spacing() {
        // Neither the spacing nor the aspect asks for more.
        assert_eq!(count_lattice_steps([1.0, 0.7], 1.0), [1, 1]);
        assert_eq!(count_lattice_steps([1.0, 0.5], 1.0), [2, 1]);
        assert_eq!(count_lattice_steps([0.5, 1.0], 1.0), [1, 2]);
        // A ledge: 0.3 wide, steps of 0.45 at most; a thinner one: quarters.
        assert_eq!(count_lattice_steps([8.0, 0.3], 1.0), [18, 1]);
        assert_eq!(count_lattice_steps([8.0, 0.01], 1.0), [32, 1]);
        assert_eq!(count_lattice_steps([0.01, 0.2], 1.0), [1, 1]);
        assert_eq!(count_lattice_steps([8.0, 0.01], f64::INFINITY), [1, 1]);
        assert_eq!(count_lattice_steps([1.0, f64::NAN], 1.0), [1, 1]);
        let mut next = random(4);
        for _ in 0..1000 {
            let (lengths, spacing) = ([next() * 9.0, next() * next()], 0.05 + next());
            let steps = count_lattice_steps(lengths, spacing);
            let coarser = count_lattice_steps(lengths, spacing * (1.0 + next()));
            assert!(steps[0] * steps[1] >= coarser[0] * coarser[1], "{lengths:?} {spacing}");
            let edges = [0, 1].map(|k| lengths[k] / steps[k] as f64);
            let (long, short) = (edges[0].max(edges[1]), edges[0].min(edges[1]));
            // One step less than a quarter would be above it.
            assert!(long <= (1.51 * short).max(0.5 * spacing) * 1.01, "{lengths:?} {spacing}");
        }
    }

    #[test]
    fn rounding_of_edges_does_not_add_a_step() {
        assert_eq!(count_steps(1.0, 0.25), 4);
        assert_eq!(count_steps(1.000_000_1, 0.25), 4);
        assert_eq!(count_steps(0.999_999_9, 0.25), 4);
        assert_eq!(count_steps(1.01, 0.25), 5);
        assert_eq!(count_steps(1.0, f64::INFINITY), 1);
        assert_eq!(count_steps(1.0, 1e-300), 1 << 31);
        assert_eq!(count_steps(f64::NAN, 1.0), 1);
    }
}
