//! The lattice that cuts a triangle, or a parallelogram of two, into micropolygons.

use pbgi_math::DVec3;
use std::f64::consts::PI;

/// Most steps along one edge; keeps every product of two step counts below 2⁶².
const STEPS_MAX: u64 = 1 << 31;

/// Steps are rounded up, but a length this little above a whole number of steps does not take one
/// more: equal edges of neighboring triangles, unequal by rounding, take equal steps.
const STEP_SLACK: f64 = 1e-3;

/// Largest cosine between a cell's edges with which it is drawn as a rectangle, and two triangles are diced as one: 30° off the right angle, and some rounding.
pub(super) const SKEW_COSINE_MAX: f64 = 0.5 + 1e-6;

/// Most a cell's long edge measures in short edges; where this needs more steps along the long edge, they are added.
const ASPECT_MAX: f64 = 1.5;

/// ... but not so many that they are shorter than this share of the spacing.
const SPACING_SHARE_MIN: f64 = 0.25;

/// Covering radius over the radius of the disk of the same area from which on a clipped cell is a sliver and drawn as a rectangle: half a
/// square, at 1.9, is not.
const SLIVER_RATIO: f64 = 2.0;

/// Length of a sliver's rectangle over the sliver's: such a rectangle has about the moment of inertia of a triangle.
const SLIVER_LENGTH: f64 = 0.8;

/// A corner of a piece of a triangle.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    position: DVec3,
    barycentric: DVec3,
}

/// A triangle, half of one, or a parallelogram under a lattice of parallelograms.
///
/// The first corner is the one nearest to a right angle; the lattice has `u_steps` steps along the
/// edge to the second corner and `v_steps` along the edge to the third. Cell (i, j) is what lies in
/// the triangle of the parallelogram between steps i..i+1 and j..j+1. Two halves of a parallelogram
/// get lattices that coincide. A parallelogram that is diced as one has whole cells only.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lattice {
    origin: Corner,
    /// Edge vectors (and barycentric differences) to the second and third corner, over the steps.
    u: Corner,
    v: Corner,
    u_steps: u64,
    v_steps: u64,
    /// All of the parallelogram, not the half of it with the first corner.
    full: bool,
    /// Area of a whole cell.
    cell_area: f64,
    /// Covering radius of a whole cell: half its longer diagonal.
    cell_radius: f64,
    /// The rectangle whole cells are drawn as, if they are near one.
    rectangle: Option<Rectangle>,
}

/// A rectangle with the area of a whole cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rectangle {
    /// Along its long edge.
    pub direction: DVec3,
    /// Long over short edge.
    pub aspect: f64,
}

/// One micropolygon of a lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// Centroid.
    pub center: DVec3,
    /// Barycentric coordinates of the centroid in the whole triangle.
    pub barycentric: DVec3,
    /// Exact area.
    pub area: f64,
    /// Largest distance of a vertex from the centroid.
    pub radius: f64,
    column: u64,
    row: u64,
    /// A whole parallelogram of the lattice.
    pub whole: bool,
    /// The rectangle a clipped cell is drawn as, if it is a sliver.
    pub sliver: Option<Rectangle>,
}

/// A triangle as one or two lattices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattices {
    pub pieces: [Lattice; 2],
    pub piece_count: usize,
}

impl Lattices {
    /// Dices the triangle `positions` with steps of at most `spacing`. A triangle with an angle above
    /// 120° and longer than that is first split by the altitude from that corner, so no cell is a
    /// narrow rhomb.
    pub fn new(positions: [DVec3; 3], spacing: f64) -> Self {
        let corner = |i: usize| Corner::of_triangle(positions, i);
        // The angle nearest to 90° is the largest one: opposite the longest edge.
        let opposite = |i: usize| positions[(i + 1) % 3].distance_squared(positions[(i + 2) % 3]);
        let apex = (1..3).fold(0, |best, i| if opposite(i) > opposite(best) { i } else { best });
        let [a, b, c] = [corner(apex), corner(apex + 1), corner(apex + 2)];
        let (ab, ac) = (b.position - a.position, c.position - a.position);
        let obtuse = ab.dot(ac) < -0.5 * (ab.length_squared() * ac.length_squared()).sqrt();
        if !obtuse || count_steps(b.position.distance(c.position), spacing) == 1 {
            let whole = Lattice::new([a, b, c], spacing);
            return Self { pieces: [whole, Lattice::default()], piece_count: 1 };
        }
        let bc = c.position - b.position;
        let foot = b.lerp(c, -ab.dot(bc) / bc.length_squared());
        let pieces = [Lattice::new([foot, a, b], spacing), Lattice::new([foot, c, a], spacing)];
        Self { pieces, piece_count: 2 }
    }

    /// Dices the parallelogram over the edges from corner `apex` of the triangle `positions`; it has this `area`.
    /// Barycentric coordinates beyond the triangle are outside 0..=1.
    pub fn of_parallelogram(positions: [DVec3; 3], apex: usize, area: f64, spacing: f64) -> Self {
        let corners = [0, 1, 2].map(|k| Corner::of_triangle(positions, apex + k));
        let mut whole = Lattice::new(corners, spacing);
        whole.full = true;
        whole.cell_area = area / (whole.u_steps * whole.v_steps) as f64;
        Self { pieces: [whole, Lattice::default()], piece_count: 1 }
    }

    /// Micropolygons of the triangle or parallelogram.
    pub fn cell_count(&self) -> u64 {
        self.pieces[..self.piece_count].iter().map(Lattice::cell_count).sum()
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

    fn step_to(self, other: Self, steps: u64) -> Self {
        Self {
            position: (other.position - self.position) / steps as f64,
            barycentric: (other.barycentric - self.barycentric) / steps as f64,
        }
    }
}

impl Rectangle {
    /// The rectangle with the longer of two edges and the parallelogram's area: rows of such rectangles along that edge
    /// cover what rows of parallelograms do. `None` where the edges are too far from a right angle.
    fn of_parallelogram(u: DVec3, v: DVec3) -> Option<Self> {
        let long = if u.length_squared() >= v.length_squared() { u } else { v };
        let (length_squared, area) = (long.length_squared(), u.cross(v).length());
        let skew =
            u.dot(v).abs() / (length_squared * u.length_squared().min(v.length_squared())).sqrt();
        let aspect = length_squared / area;
        (skew <= SKEW_COSINE_MAX && aspect.is_finite()).then_some(Self { direction: long, aspect })
    }
}

impl Lattice {
    fn new([a, b, c]: [Corner; 3], spacing: f64) -> Self {
        let (u_length, v_length) =
            (a.position.distance(b.position), a.position.distance(c.position));
        let [u_steps, v_steps] = count_lattice_steps([u_length, v_length], spacing);
        let (u, v) = (a.step_to(b, u_steps), a.step_to(c, v_steps));
        let diagonals = [u.position + v.position, u.position - v.position];
        Self {
            origin: a,
            u,
            v,
            u_steps,
            v_steps,
            full: false,
            cell_area: u.position.cross(v.position).length(),
            cell_radius: 0.5 * diagonals[0].length().max(diagonals[1].length()),
            rectangle: Rectangle::of_parallelogram(u.position, v.position),
        }
    }

    /// The rectangle whole cells are drawn as, if they are near one.
    pub fn rectangle(&self) -> Option<Rectangle> {
        self.rectangle
    }

    /// Cells that meet the inside of the triangle: below the diagonal of the m × n grid there are
    /// (m n + m + n − gcd(m, n)) / 2, for the diagonal crosses m + n − gcd(m, n) cells.
    pub fn cell_count(&self) -> u64 {
        let (m, n) = (self.u_steps, self.v_steps);
        if self.full {
            return m * n;
        }
        (m * n + m + n - gcd(m, n)) / 2
    }

    /// Number of rows.
    pub fn row_count(&self) -> u64 {
        self.v_steps
    }

    /// Cells of `row` that meet the inside of the triangle.
    pub fn column_count(&self, row: u64) -> u64 {
        if self.full {
            return self.u_steps;
        }
        (self.u_steps * (self.v_steps - row)).div_ceil(self.v_steps)
    }

    /// How many of them, counted from 0, are whole parallelograms.
    pub fn whole_column_count(&self, row: u64) -> u64 {
        if self.full {
            return self.u_steps;
        }
        self.u_steps * (self.v_steps - row - 1) / self.v_steps
    }

    /// Cell (column, row), whole or clipped.
    #[inline]
    pub fn cell(&self, column: u64, row: u64) -> Cell {
        if column < self.whole_column_count(row) {
            self.whole_cell(column, row)
        } else {
            self.clipped_cell(column, row)
        }
    }

    /// The whole parallelogram (column, row).
    #[inline]
    pub fn whole_cell(&self, column: u64, row: u64) -> Cell {
        let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
        Cell {
            center: self.origin.position + self.u.position * x + self.v.position * y,
            barycentric: self.origin.barycentric + self.u.barycentric * x + self.v.barycentric * y,
            area: self.cell_area,
            radius: self.cell_radius,
            column,
            row,
            whole: true,
            sliver: None,
        }
    }

    /// Cell (column, row) clipped by the third edge: a polygon of three to five vertices.
    pub fn clipped_cell(&self, column: u64, row: u64) -> Cell {
        let (polygon, count) = self.clip(column, row);
        let polygon = &polygon[..count];
        // Area and centroid by the shoelace formula, in steps from the cell's first corner.
        let (mut double_area, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
        for (k, &[x0, y0]) in polygon.iter().enumerate() {
            let [x1, y1] = polygon[(k + 1) % count];
            let cross = x0 * y1 - x1 * y0;
            double_area += cross;
            x_sum += (x0 + x1) * cross;
            y_sum += (y0 + y1) * cross;
        }
        let (x, y) = if double_area > 0.0 {
            (x_sum / (3.0 * double_area), y_sum / (3.0 * double_area))
        } else {
            (0.0, 0.0)
        };
        let reach = |&[px, py]: &[f64; 2]| {
            (self.u.position * (px - x) + self.v.position * (py - y)).length_squared()
        };
        let radius_squared = polygon.iter().map(reach).fold(0.0, f64::max);
        let (x, y) = (x + column as f64, y + row as f64);
        Cell {
            center: self.origin.position + self.u.position * x + self.v.position * y,
            barycentric: self.origin.barycentric + self.u.barycentric * x + self.v.barycentric * y,
            area: 0.5 * double_area * self.cell_area,
            radius: radius_squared.sqrt(),
            column,
            row,
            whole: false,
            sliver: self.sliver(polygon, 0.5 * double_area * self.cell_area, radius_squared),
        }
    }

    /// The rectangle for a clipped cell, of this area and squared covering radius, if a disk is none for it.
    fn sliver(&self, polygon: &[[f64; 2]], area: f64, radius_squared: f64) -> Option<Rectangle> {
        if !(radius_squared * PI > SLIVER_RATIO * SLIVER_RATIO * area) {
            return None;
        }
        let at = |[x, y]: [f64; 2]| self.u.position * x + self.v.position * y;
        let mut longest = DVec3::ZERO;
        for (i, a) in polygon.iter().enumerate() {
            for b in &polygon[i + 1..] {
                let between = at(*b) - at(*a);
                if between.length_squared() > longest.length_squared() {
                    longest = between;
                }
            }
        }
        let aspect = longest.length_squared() * SLIVER_LENGTH * SLIVER_LENGTH / area;
        aspect.is_finite().then_some(Rectangle { direction: longest, aspect: aspect.max(1.0) })
    }

    /// The part of cell (column, row) in the triangle, as vertices in steps from the cell's first
    /// corner, counterclockwise, and their number.
    fn clip(&self, column: u64, row: u64) -> ([[f64; 2]; 6], usize) {
        const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let inside = |[x, y]: [f64; 2]| self.inside(column, row, x, y);
        let mut polygon = [[0.0; 2]; 6];
        let mut count = 0;
        let mut push = |vertex: [f64; 2]| {
            polygon[count] = vertex;
            count += 1;
        };
        for (k, &from) in SQUARE.iter().enumerate() {
            let to = SQUARE[(k + 1) % 4];
            let (from_inside, to_inside) = (inside(from), inside(to));
            if from_inside >= 0.0 {
                push(from);
            }
            if (from_inside > 0.0) != (to_inside > 0.0) && from_inside != 0.0 && to_inside != 0.0 {
                let t = from_inside / (from_inside - to_inside);
                push([from[0] + (to[0] - from[0]) * t, from[1] + (to[1] - from[1]) * t]);
            }
        }
        (polygon, count)
    }

    /// At least 0 where the point `x`, `y` steps into cell (column, row) is in the triangle:
    /// mn − (column + x) n − (row + y) m, the whole numbers taken first to lose no digits.
    fn inside(&self, column: u64, row: u64, x: f64, y: f64) -> f64 {
        let (m, n) = (self.u_steps, self.v_steps);
        let rest = m * n - column * n - row * m;
        rest as f64 - x * n as f64 - y * m as f64
    }

    /// Barycentric coordinates of the points of a regular `edge` × `edge` grid over `cell` that lie
    /// in it; the centroid if none does. Calls `visit` with each.
    pub fn visit_grid(&self, cell: &Cell, edge: u32, mut visit: impl FnMut(DVec3)) {
        let mut visited = false;
        for k in 0..edge * edge {
            let x = (f64::from(k % edge) + 0.5) / f64::from(edge);
            let y = (f64::from(k / edge) + 0.5) / f64::from(edge);
            if cell.whole || self.inside(cell.column, cell.row, x, y) >= 0.0 {
                let (x, y) = (x + cell.column as f64, y + cell.row as f64);
                visit(self.origin.barycentric + self.u.barycentric * x + self.v.barycentric * y);
                visited = true;
            }
        }
        if !visited {
            visit(cell.barycentric);
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

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Calls `visit` with every cell of a triangle.
    pub fn visit_cells(lattices: &Lattices, mut visit: impl FnMut(&Lattice, Cell)) {
        for lattice in &lattices.pieces[..lattices.piece_count] {
            for row in 0..lattice.row_count() {
                for column in 0..lattice.column_count(row) {
                    visit(lattice, lattice.cell(column, row));
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
            visit_cells(&lattices, |_, cell| {
                assert!(cell.area > 0.0 && cell.radius > 0.0);
                let b = cell.barycentric;
                assert!(b.min_element() > -1e-12 && (b.element_sum() - 1.0).abs() < 1e-12);
                assert!((t[0] * b.x + t[1] * b.y + t[2] * b.z - cell.center).length() < 1e-11);
                sum += cell.area;
                moment += cell.center * cell.area;
                count += 1;
            });
            assert!((sum / area - 1.0).abs() < 1e-8, "{sum} {area} {t:?}");
            assert!((moment / sum - centroid).length() < 1e-6);
            assert_eq!(count, lattices.cell_count());
        }
    }

    #[test]
    fn every_point_is_covered_by_a_disk() {
        let mut next = random(2);
        for _ in 0..200 {
            let t = random_triangle(&mut next);
            let mut disks = vec![];
            visit_cells(&Lattices::new(t, 0.3 + next()), |_, cell| {
                disks.push((cell.center, cell.radius));
            });
            for _ in 0..100 {
                let (mut x, mut y) = (next(), next());
                if x + y > 1.0 {
                    (x, y) = (1.0 - x, 1.0 - y);
                }
                let point = t[0] + (t[1] - t[0]) * x + (t[2] - t[0]) * y;
                let covered = |&(center, radius): &(DVec3, f64)| {
                    point.distance(center) <= radius * (1.0 + 1e-9) + 1e-12
                };
                assert!(disks.iter().any(covered), "{point} of {t:?}");
            }
        }
    }

    #[test]
    fn cells_are_no_wider_than_the_spacing_allows() {
        let mut next = random(3);
        for _ in 0..200 {
            let spacing = 0.1 + next();
            visit_cells(&Lattices::new(random_triangle(&mut next), spacing), |_, cell| {
                // Half the longer diagonal of a rhomb of 120°.
                assert!(cell.radius <= 0.867 * spacing * 1.01);
            });
        }
    }

    #[test]
    fn halves_of_a_rectangle_share_their_lattice() {
        let (a, b) = (DVec3::new(1.7, 0.3, -0.2), DVec3::new(0.1, 0.2, 1.15));
        let origin = DVec3::new(0.4, 2.0, -5.0);
        let collect = |t: [DVec3; 3]| {
            let (mut whole, mut halves) = (vec![], vec![]);
            visit_cells(&Lattices::new(t, 0.1), |_, cell| {
                if cell.whole { whole.push(cell) } else { halves.push(cell) }
            });
            (whole, halves)
        };
        let first = collect([origin, origin + a, origin + b]);
        let second = collect([origin + a + b, origin + b, origin + a]);
        let offsets = |cells: &[Cell]| {
            let (u, v) = (a / 18.0, b / 12.0);
            let at = |c: &Cell| {
                let d = c.center - origin;
                let n = a.cross(b);
                let coordinates = [d.cross(b).dot(n), a.cross(d).dot(n)].map(|x| x / n.dot(n));
                [coordinates[0] * a.length() / u.length(), coordinates[1] * b.length() / v.length()]
            };
            cells.iter().map(at).collect::<Vec<_>>()
        };
        for cells in [&first.0, &second.0] {
            for [x, y] in offsets(cells) {
                assert!((x.fract() - 0.5).abs() < 1e-9 && (y.fract() - 0.5).abs() < 1e-9);
            }
        }
        // A clipped cell of one half completes one of the other half.
        let total: f64 = first.1.iter().chain(&second.1).map(|c| c.area).sum();
        let whole = a.cross(b).length() - (first.0.len() + second.0.len()) as f64 * first.0[0].area;
        assert!((total / whole - 1.0).abs() < 1e-9);
    }

    #[test]
    fn skew_cells_have_no_rectangle() {
        let v = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            DVec3::new(cos, sin, 0.0) * 0.5
        };
        for (degrees, known) in [(90.0, true), (60.0, true), (120.0, true), (59.0, false)] {
            let rectangle = Rectangle::of_parallelogram(v(degrees), DVec3::X);
            assert_eq!(rectangle.is_some(), known, "{degrees}");
            if let Some(Rectangle { direction, aspect }) = rectangle {
                assert_eq!(direction, DVec3::X);
                assert!((1.0 / aspect - 0.5 * degrees.to_radians().sin()).abs() < 1e-12);
            }
        }
        assert!(Rectangle::of_parallelogram(DVec3::ZERO, DVec3::X).is_none());
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
