use glam::Vec3;

use super::curves::{curve, smoothstep};
use super::half::{Half, Mark, Part};
use super::identity::{CANON, Plan};
use super::mouth::{CANON_LIP, Lips};
use super::nose::Nose;
use super::skull::Skull;
use super::{eyes, face, mouth, neck};
use crate::Region;

/// Columns from the front midline to the back midline, and the columns where the slits end.
const COLUMNS: usize = 54;
const INNER_CANTHUS: usize = 14;
const OUTER_CANTHUS: usize = 39;
const MOUTH_CORNER: usize = 25;

/// Where the tragus of the ear is on the average head, about.
pub(super) const TRAGUS: Vec3 = Vec3::new(72.0, 3.0, -4.0);

/// Rows of the grid across the vermilion of each lip.
pub(super) const LIP_ROWS: isize = 8;

/// The skin as a grid of rows from the crown down and columns from the front midline around to the back. Eyes and mouth are
/// slits between two rows: the rows follow the edges of lids and lips, and separate there.
pub(super) struct Grid<'a> {
    plan: &'a Plan,
    skull: Skull,
    nose: Nose,
    lips: Lips,
    rows: Vec<Row>,
    eye_row: usize,
    mouth_row: usize,
    columns: Vec<f32>,
}

#[derive(Debug, Clone, Copy)]
struct Row {
    /// Height in front in the average face, or below any face for the rows of crown and neck that follow the stations.
    canon: f32,
    station: f32,
}

/// Results that later stages need.
pub(super) struct Skin {
    /// Depth of the line between the lips at the midline.
    pub lips: f32,
    /// Position of the ear's tragus.
    pub ear: Vec3,
    /// Skin vertices by row and column; on the rows of the slits, the upper one.
    pub grid: Vec<Vec<u32>>,
    pub eye_row: usize,
    pub mouth_row: usize,
    /// The lower rows of the slits.
    pub under_eye: Vec<u32>,
    pub under_mouth: Vec<u32>,
    /// Columns of the inner canthus, one third, two thirds, and the outer canthus.
    pub eye_columns: [usize; 4],
    pub mouth_corner: usize,
}

impl<'a> Grid<'a> {
    pub(super) fn new(plan: &'a Plan) -> Self {
        let skull = Skull::new(plan);
        let heights = face_rows();
        let face = |row: &f32| Row { canon: *row, station: skull.station(plan.height(*row)) };
        let mut rows: Vec<Row> = heights.iter().map(face).collect();
        let top = rows[0].station;
        let crown = (0..10).map(|i| Row { canon: f32::INFINITY, station: top * i as f32 / 10.0 });
        rows.splice(0..0, crown);
        let bottom = rows[rows.len() - 1].station;
        let below = (1..=18).map(|i| {
            let t = i as f32 / 18.0;
            Row { canon: f32::NEG_INFINITY, station: bottom + (skull.end() - bottom) * t * (0.6 + 0.4 * t) }
        });
        rows.extend(below);
        let row_at = |canon: f32| rows.iter().position(|row| (row.canon - canon).abs() < 1e-3).unwrap_or(0);
        let (eye_row, mouth_row) = (row_at(CANON[0]), row_at(CANON[2]));
        let columns = (0..=COLUMNS).map(azimuth).collect();
        Self { plan, skull, nose: Nose::new(plan), lips: Lips::new(), rows, eye_row, mouth_row, columns }
    }

    /// Builds the skin with its openings and their linings.
    pub(super) fn lay(&self, half: &mut Half) -> Skin {
        let grid: Vec<Vec<u32>> = (0..self.rows.len())
            .map(|row| {
                let mut line: Vec<u32> = Vec::with_capacity(COLUMNS + 1);
                for column in 0..=COLUMNS {
                    // The crown is a single vertex.
                    if row == 0 && column > 0 {
                        line.push(line[0]);
                    } else {
                        line.push(self.vertex(half, row, column, true));
                    }
                }
                line
            })
            .collect();
        let eye = self.under_slit(half, &grid[self.eye_row], self.eye_row, INNER_CANTHUS, OUTER_CANTHUS);
        let mouth = self.under_slit(half, &grid[self.mouth_row], self.mouth_row, 0, MOUTH_CORNER);
        for row in 0..grid.len() - 1 {
            let above = match row {
                row if row == self.eye_row => &eye,
                row if row == self.mouth_row => &mouth,
                row => &grid[row],
            };
            let place = |column: usize| self.region(half, above[column], row, column);
            let regions: Vec<Region> = (0..COLUMNS).map(place).collect();
            half.strip(above, &grid[row + 1], |column| regions[column]);
        }
        self.line_eye(half, &grid[self.eye_row], &eye);
        self.line_mouth(half, &grid[self.mouth_row], &mouth);
        let lips = half.points[grid[self.mouth_row][0] as usize].z;
        let third = (OUTER_CANTHUS - INNER_CANTHUS) / 3;
        Skin {
            lips,
            ear: self.ear_root(half, &grid),
            grid,
            eye_row: self.eye_row,
            mouth_row: self.mouth_row,
            under_eye: eye,
            under_mouth: mouth,
            eye_columns: [INNER_CANTHUS, INNER_CANTHUS + third, OUTER_CANTHUS - third, OUTER_CANTHUS],
            mouth_corner: MOUTH_CORNER,
        }
    }

    /// The lower row of vertices of a slit: separate between the ends, shared with the row elsewhere.
    fn under_slit(&self, half: &mut Half, line: &[u32], row: usize, first: usize, last: usize) -> Vec<u32> {
        let mut below = line.to_vec();
        let open = if first == 0 { 0..last } else { first + 1..last };
        for column in open {
            below[column] = self.vertex(half, row, column, false);
        }
        below
    }

    fn vertex(&self, half: &mut Half, row: usize, column: usize, above_slit: bool) -> u32 {
        let (point, mark) = self.place(row, column, above_slit);
        half.vertex(point, mark)
    }

    fn place(&self, row: usize, column: usize, above_slit: bool) -> (Vec3, Mark) {
        let Row { canon, station } = self.rows[row];
        let azimuth = self.columns[column];
        let middle = column == 0 || column == COLUMNS || row == 0;
        let mut mark = Mark { midline: middle, ..Mark::of(Part::Skin) };
        let base = self.skull.point(station, azimuth);
        let mut p = base;
        if canon.is_finite() && azimuth < 1.35 {
            // Signed by the side of the slit, also on the slit itself.
            let signed = |over: f32| if over == 0.0 { if above_slit { 1e-3 } else { -1e-3 } } else { over };
            let (eye_over, mouth_over) = (signed(canon - CANON[0]), signed(canon - CANON[2]));
            let (x, y) = self.slide(base, row, column, eye_over, mouth_over);
            if x != base.x || y != base.y {
                let (station, azimuth) = self.skull.beneath(x, y, (station, azimuth));
                p = self.skull.point(station, azimuth);
            }
            if middle {
                p.x = 0.0;
            }
            p = self.sculpt(p, mouth_over);
            mark.eye = eye_over;
            mark.mouth = mouth_over;
            mark.along = if eye_over.abs() < mouth_over.abs() {
                eyes::along_lid(self.plan, p.x)
            } else {
                (p.x / self.plan.mouth_half_width).min(1.0)
            };
        }
        if p.y < self.plan.chin + 60.0 {
            p += neck::relief(self.plan, p, self.outward(station, azimuth));
        }
        if middle {
            p.x = 0.0;
        }
        (p, mark)
    }

    /// Targets of the grid's rows and columns, which align them with the edges of lids and lips.
    fn slide(&self, base: Vec3, row: usize, column: usize, eye_over: f32, mouth_over: f32) -> (f32, f32) {
        let plan = self.plan;
        let (mut x, mut y) = (base.x, base.y);
        let eye_near = 1.0 - smoothstep(12.0, 34.0, eye_over.abs());
        if eye_near > 0.0 {
            let at =
                |column: usize| self.skull.point(self.rows[self.eye_row].station, self.columns[column]).x;
            let target = between(
                at(column),
                [
                    (0.0, 0.0),
                    (at(INNER_CANTHUS), plan.inner_canthus.x),
                    (at(OUTER_CANTHUS), plan.outer_canthus.x),
                ],
            );
            x += (target - at(column)) * eye_near * (1.0 - smoothstep(50.0, 75.0, base.x));
            let beside = 1.0 - smoothstep(plan.outer_canthus.x + 2.0, plan.outer_canthus.x + 20.0, x);
            let upper = eye_over > 0.0;
            let opened = eyes::opened_height(plan, x, eye_over, upper);
            let inside = smoothstep(0.0, plan.inner_canthus.x * 0.75, x);
            y += (opened - plan.eye.y - eye_over) * beside * inside;
        }
        let mouth_near = 1.0 - smoothstep(12.0, 32.0, mouth_over.abs());
        if mouth_near > 0.0 {
            let at =
                |column: usize| self.skull.point(self.rows[self.mouth_row].station, self.columns[column]).x;
            let corner = at(MOUTH_CORNER);
            let target = between(
                at(column),
                [(0.0, 0.0), (0.5 * corner, 0.5 * plan.mouth_half_width), (corner, plan.mouth_half_width)],
            );
            x += (target - at(column)) * mouth_near * (1.0 - smoothstep(36.0, 60.0, base.x));
            let beside = 1.0 - smoothstep(plan.mouth_half_width + 6.0, plan.mouth_half_width + 30.0, x);
            let laid = mouth::lip_row(plan, x, mouth_over);
            y += (laid - plan.height(self.rows[row].canon)) * beside * mouth_near;
        }
        (x, y)
    }

    /// Applies the features to the bare face at `p`.
    fn sculpt(&self, p: Vec3, mouth_over: f32) -> Vec3 {
        let plan = self.plan;
        let front = 1.0 - smoothstep(-20.0, 15.0, -p.z);
        let mut q = p + face::relief(plan, p) * front;
        let middle = self.skull.point(self.skull.station(p.y), 0.0);
        q += self.nose.raise(p, middle.z + face::relief(plan, middle).z);
        let over = p.y - mouth::slit(plan, p.x);
        let over = if over.abs() < 0.02 || over.signum() != mouth_over.signum() {
            0.0_f32.copysign(mouth_over)
        } else {
            over
        };
        q += self.lips.relief(plan, p, over);
        eyes::drape(plan, q)
    }

    fn outward(&self, station: f32, azimuth: f32) -> Vec3 {
        let here = self.skull.point(station, azimuth);
        let down = self.skull.point(station + 0.5, azimuth) - self.skull.point(station - 0.5, azimuth);
        let around = self.skull.point(station, azimuth + 0.01) - here;
        down.cross(around).normalize_or_zero()
    }

    fn line_eye(&self, half: &mut Half, above: &[u32], below: &[u32]) {
        let columns = INNER_CANTHUS..=OUTER_CANTHUS;
        let region = |row: usize| if row <= 2 { Region::LidMargin } else { Region::InnerLid };
        let mut upper = above[columns.clone()].to_vec();
        let mut lower = below[columns.clone()].to_vec();
        let (margin_upper, margin_lower) = (upper.clone(), lower.clone());
        let last = upper.len() - 1;
        for row in 1..=eyes::LINING_ROWS {
            let mut next = |margin: &[u32], is_upper: bool, ends: Option<&[u32]>| -> Vec<u32> {
                (0..=last)
                    .map(|i| match ends {
                        Some(ends) if i == 0 || i == last => ends[i],
                        _ => {
                            let from = margin[i] as usize;
                            // At the canthi both linings merge and go straight back.
                            let end = i == 0 || i == last;
                            let point = if end {
                                half.points[from] - Vec3::new(0.0, 0.0, 1.2 * row as f32)
                            } else {
                                eyes::lining(self.plan, half.points[from], row, is_upper)
                            };
                            let mark = Mark { part: Part::LidLining, ..half.marks[from] };
                            half.vertex(point, mark)
                        }
                    })
                    .collect()
            };
            let next_upper = next(&margin_upper, true, None);
            let next_lower = next(&margin_lower, false, Some(&next_upper));
            half.strip(&upper, &next_upper, |_| region(row));
            half.strip(&next_lower, &lower, |_| region(row));
            (upper, lower) = (next_upper, next_lower);
        }
    }

    fn line_mouth(&self, half: &mut Half, above: &[u32], below: &[u32]) {
        let edges = [above[..=MOUTH_CORNER].to_vec(), below[..=MOUTH_CORNER].to_vec()];
        let [mut upper, mut lower] = edges.clone();
        for row in 1..=mouth::LINING_ROWS {
            let back = row == mouth::LINING_ROWS;
            let mut next = |edge: &[u32], is_upper: bool, shared: Option<&[u32]>| -> Vec<u32> {
                (0..=MOUTH_CORNER)
                    .map(|i| match shared {
                        Some(shared) if i == MOUTH_CORNER || back => shared[i],
                        _ => {
                            let from = edge[i] as usize;
                            let point = mouth::lining(self.plan, half.points[from], row, is_upper);
                            let mark =
                                Mark { part: Part::MouthLining { depth: row as u8 }, ..half.marks[from] };
                            half.vertex(point, mark)
                        }
                    })
                    .collect()
            };
            let next_upper = next(&edges[0], true, None);
            let next_lower = next(&edges[1], false, Some(&next_upper));
            let region = if row <= 2 { Region::Lips } else { Region::MouthInside };
            half.strip(&upper, &next_upper, |_| region);
            half.strip(&next_lower, &lower, |_| region);
            (upper, lower) = (next_upper, next_lower);
        }
    }

    /// The region of the cell of the grid below `row` and right of `column`.
    fn region(&self, half: &Half, corner: u32, row: usize, column: usize) -> Region {
        let p = half.points[corner as usize];
        let Row { canon, .. } = self.rows[row];
        if canon == f32::NEG_INFINITY {
            return Region::Neck;
        }
        let lip = canon <= CANON[2] + CANON_LIP + 1e-3 && canon > CANON[2] - CANON_LIP + 1e-3;
        if lip && column < MOUTH_CORNER {
            return Region::Lips;
        }
        let angle = libm::atan2f(p.x, p.z);
        if p.y > hairline(self.plan, angle) {
            return Region::Scalp;
        }
        if brow(self.plan, p) { Region::Brow } else { Region::Skin }
    }

    /// The skin vertex nearest to the ear's tragus.
    fn ear_root(&self, half: &Half, grid: &[Vec<u32>]) -> Vec3 {
        let mut nearest = TRAGUS;
        let mut distance = f32::INFINITY;
        for &vertex in grid.iter().flatten() {
            let p = half.points[vertex as usize];
            let d = (p - TRAGUS).with_x(0.0).length() + if p.x < 30.0 { 100.0 } else { 0.0 };
            if d < distance {
                (nearest, distance) = (p, d);
            }
        }
        Vec3::new(nearest.x + 0.6, TRAGUS.y, TRAGUS.z)
    }
}

/// Heights of the grid's rows in the average face, from the hairline to the throat: densest along lids, nostrils and lips.
fn face_rows() -> Vec<f32> {
    const SPANS: [(f32, f32, usize); 14] = [
        (98.0, 78.0, 7),
        (78.0, 54.0, 8),
        (54.0, 40.0, 8),
        (40.0, 34.0, 6),
        (34.0, CANON[0], 8),
        (CANON[0], 22.0, 8),
        (22.0, 14.0, 7),
        (14.0, -6.0, 10),
        (-6.0, -27.0, 22),
        (-27.0, CANON[2] + CANON_LIP, 6),
        (CANON[2] + CANON_LIP, CANON[2], 8),
        (CANON[2], CANON[2] - CANON_LIP, 8),
        (CANON[2] - CANON_LIP, -58.0, 5),
        (-58.0, -92.0, 13),
    ];
    let mut rows = vec![SPANS[0].0];
    for (from, to, count) in SPANS {
        rows.extend((1..=count).map(|i| from + (to - from) * i as f32 / count as f32));
    }
    rows
}

/// Azimuth of a column: evenly spaced across the face, wider around the back.
fn azimuth(column: usize) -> f32 {
    const FACE: usize = 43;
    const WIDTH: f32 = 71.0;
    let x = if column <= 23 { 1.15 * column as f32 } else { 26.45 + 1.2 * (column as f32 - 23.0) };
    if column <= FACE {
        return libm::asinf(x / WIDTH);
    }
    let start = libm::asinf((26.45 + 1.2 * 20.0) / WIDTH);
    let t = (column - FACE) as f32 / (COLUMNS - FACE) as f32;
    let rest = std::f32::consts::PI - start;
    // Starts with the face's spacing and widens.
    let begin = 0.026 * (COLUMNS - FACE) as f32 / rest;
    start + rest * (begin * t + (1.0 - begin) * t * t * (1.5 - 0.5 * t))
}

/// Linear interpolation through the three points, and a constant offset beyond the last.
fn between(x: f32, points: [(f32, f32); 3]) -> f32 {
    let [a, b, c] = points;
    let line = |p: (f32, f32), q: (f32, f32)| p.1 + (q.1 - p.1) * (x - p.0) / (q.0 - p.0);
    if x <= b.0 {
        line(a, b)
    } else if x <= c.0 {
        line(b, c)
    } else {
        x + c.1 - c.0
    }
}

fn hairline(plan: &Plan, angle: f32) -> f32 {
    let line = 2.0 * plan.traits.crown_height;
    let line = curve(&[
        (0.0, 88.0 + line),
        (0.25, 88.5 + line),
        (0.5, 85.0 + line),
        (0.7, 74.0),
        (0.88, 56.0),
        (1.05, 46.0),
        (1.2, 26.0),
        (1.32, -4.0),
        (1.42, -2.0),
        (1.52, 20.0),
        (1.65, 36.0),
        (1.85, 24.0),
        (2.05, -10.0),
        (2.3, -42.0),
        (2.7, -70.0),
        (std::f32::consts::PI, -78.0),
    ]);
    line.at(angle)[0]
}

/// Centre height of the eyebrow at `x`.
pub(super) fn brow_height(plan: &Plan, x: f32) -> f32 {
    let arch = curve(&[(6.0, 16.5), (12.0, 18.0), (22.0, 19.8), (34.0, 21.6), (42.0, 21.0), (52.0, 16.5)]);
    plan.eye.y + arch.at(x)[0]
}

fn brow(plan: &Plan, p: Vec3) -> bool {
    let half_height = 4.2 * (1.0 - smoothstep(20.0, 54.0, p.x)) + 1.2;
    let ends = p.x > 9.0 && p.x < plan.outer_canthus.x + 6.5;
    ends && p.z > 0.0 && (p.y - brow_height(plan, p.x)).abs() < half_height
}
