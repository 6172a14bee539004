//! VHAP's groups of vertices (`model/flame.py`, `FlameMask`), as far as they follow from FLAME's masks and from how its mesh is
//! connected. Edges count: vertices that are n edges from a boundary of the mesh are a ring around it.
//!
//! VHAP lists `neck_upper`, `neck_top`, `left_eyelid`, `right_eyelid`, `eyelids`, `lips_tight` and `skin` vertex by vertex, or makes them from
//! such lists; no rule gives these, and they are absent.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;

use super::teeth::{FLAME_VERTICES, rings_of_lips};

type Groups = BTreeMap<String, Vec<u32>>;

/// Rings of the inside of the lips: of all, and of the part that is divided into upper and lower.
const INSIDE: u32 = 3;
const DIVIDED_INSIDE: u32 = 2;

/// FLAME's mouth has 32 vertices around it; another mesh may have any number.
const LONGEST_RING: usize = 256;

/// Rings of the iris around the front of the eyeball.
const IRIS: u32 = 3;

/// Rings from the bottom of the mesh to the middle of the neck, and from there to the end of `neck_lower`.
const MIDDLE_OF_NECK: u32 = 6;
const LOWER_NECK: u32 = 4;

/// Rings of the lining of an eye's socket around its deepest vertex, and how near to the eyeball's centre that is, metres.
const SOCKET: u32 = 3;
const SOCKET_REACH: f32 = 0.02;

/// Single vertices that VHAP names.
const POINTS: [(&str, u32); 4] = [
    ("neck_left_point", 3193),
    ("neck_right_point", 3296),
    ("front_middle_bottom_point_boundary", 3285),
    ("back_middle_bottom_point_boundary", 3248),
];

/// Adds the groups to `groups`, which has those of the masks. `template` and `triangles` are FLAME's without teeth; `symmetric` are the
/// vertices of a mesh that is symmetric to the last digit, such as `head_template_mesh.obj`, without which there are no halves;
/// `eyeballs` are the left and the right.
///
/// Two groups are ours: `left_eye_socket` and `right_eye_socket`, the lining behind the lids.
pub(super) fn add(
    groups: &mut Groups,
    template: &[Vec3],
    triangles: &[[u32; 3]],
    eyeballs: &[Vec<u32>; 2],
    symmetric: Option<&[Vec3]>,
) {
    let mesh = Mesh::new(template, triangles);
    let mut loops = boundaries(triangles);
    loops.sort_by(|a, b| mesh.mean(b).y.total_cmp(&mesh.mean(a).y));
    if let [mouth, bottom] = &loops[..] {
        lips(groups, &mesh, mouth);
        neck(groups, &mesh, bottom);
    }
    eyes(groups, &mesh, eyeballs);
    if template.len() == FLAME_VERTICES {
        groups.extend(POINTS.map(|(name, vertex)| (name.to_owned(), vec![vertex])));
        groups.extend(rings_of_lips());
    }
    if let Some(positions) = symmetric {
        let half = |side: f32| (0..).zip(positions).filter(move |(_, p)| p.x * side >= 0.0).map(|(v, _)| v);
        groups.insert("left_half".into(), half(1.0).collect());
        groups.insert("right_half".into(), half(-1.0).collect());
    }
    unite(groups, "ears", &["right_ear", "left_ear"]);
    unite(groups, "eyeballs", &["right_eyeball", "left_eyeball"]);
    unite(groups, "irises", &["right_iris", "left_iris"]);
    unite(groups, "left_eye", &["left_eye_region", "left_eyeball"]);
    unite(groups, "right_eye", &["right_eye_region", "right_eyeball"]);
    subtract(groups, "hair", "scalp", &["face", "neck"]);
    subtract(groups, "sclerae", "eyeballs", &["irises"]);
}

/// The rings around the opening of the mouth.
fn lips(groups: &mut Groups, mesh: &Mesh, mouth: &[u32]) {
    let distance = mesh.distances(mouth);
    groups.insert("lip_inside_ring".into(), sorted(mouth.to_vec()));
    groups.insert("lip_inside".into(), at_most(&distance, INSIDE));
    // The corners of the mouth part the upper lip from the lower.
    let at = |v: &u32| mesh.template[*v as usize];
    let corner = |side: f32| {
        (0..mouth.len()).max_by(|a, b| (at(&mouth[*a]).x * side).total_cmp(&(at(&mouth[*b]).x * side)))
    };
    let (Some(left), Some(right)) = (corner(1.0), corner(-1.0)) else { return };
    let (first, second) = (left.min(right), left.max(right));
    let one: Vec<usize> = (first + 1..second).collect();
    let other: Vec<usize> = (second + 1..mouth.len()).chain(0..first).collect();
    let height =
        |columns: &[usize]| mesh.mean(&columns.iter().map(|column| mouth[*column]).collect::<Vec<_>>()).y;
    let (upper, lower) = if height(&one) > height(&other) { (one, other) } else { (other, one) };
    for (name, columns) in [("lip_inside_ring_upper", &upper), ("lip_inside_ring_lower", &lower)] {
        groups.insert(name.into(), sorted(columns.iter().map(|column| mouth[*column]).collect()));
    }
    let mut rings = vec![mouth.to_vec()];
    for ring in 1..=DIVIDED_INSIDE {
        let Some(next) = mesh.ring_beside(&distance, ring, &rings[rings.len() - 1]) else { return };
        rings.push(next);
    }
    let inside = |columns: Vec<usize>| {
        sorted(rings.iter().flat_map(|ring| columns.iter().map(|column| ring[*column])).collect())
    };
    groups.insert("lip_inside_upper".into(), inside([upper, vec![left, right]].concat()));
    groups.insert("lip_inside_lower".into(), inside(lower));
}

/// The rings above the lower end of the mesh.
fn neck(groups: &mut Groups, mesh: &Mesh, bottom: &[u32]) {
    let from_bottom = mesh.distances(bottom);
    let is_below = |v: &usize| from_bottom[*v].is_some_and(|edges| edges <= MIDDLE_OF_NECK);
    let middle: Vec<u32> = (0..)
        .zip(&from_bottom)
        .filter(|(_, edges)| **edges == Some(MIDDLE_OF_NECK))
        .map(|(v, _)| v)
        .collect();
    let from_middle = at_most(&mesh.distances(&middle), LOWER_NECK);
    groups.insert("bottomline".into(), sorted(bottom.to_vec()));
    groups
        .insert("neck_lower".into(), from_middle.into_iter().filter(|v| is_below(&(*v as usize))).collect());
}

/// The irises, and the sockets behind the lids.
fn eyes(groups: &mut Groups, mesh: &Mesh, eyeballs: &[Vec<u32>; 2]) {
    let eyes: BTreeSet<u32> = eyeballs.iter().flatten().copied().collect();
    for (side, eyeball) in ["left", "right"].into_iter().zip(eyeballs) {
        let depth = |v: &u32| mesh.template[*v as usize].z;
        let Some(front) = eyeball.iter().copied().max_by(|a, b| depth(a).total_cmp(&depth(b))) else {
            continue;
        };
        let iris = at_most(&mesh.distances(&[front]), IRIS);
        groups.insert(
            format!("{side}_iris"),
            iris.into_iter().filter(|v| eyeball.binary_search(v).is_ok()).collect(),
        );
        let centre = mesh.mean(eyeball);
        let near = |v: &u32| mesh.template[*v as usize].distance(centre) < SOCKET_REACH && !eyes.contains(v);
        let behind =
            (0..mesh.template.len() as u32).filter(near).min_by(|a, b| depth(a).total_cmp(&depth(b)));
        if let Some(deepest) = behind {
            groups.insert(format!("{side}_eye_socket"), at_most(&mesh.distances(&[deepest]), SOCKET));
        }
    }
}

/// The union of groups, if all exist.
fn unite(groups: &mut Groups, name: &str, of: &[&str]) {
    if let Some(all) = union(groups, of) {
        groups.insert(name.to_owned(), all);
    }
}

/// What is in one group and in none of the others, if all exist.
fn subtract(groups: &mut Groups, name: &str, from: &str, without: &[&str]) {
    if let (Some(from), Some(without)) = (groups.get(from), union(groups, without)) {
        let rest = from.iter().copied().filter(|v| without.binary_search(v).is_err()).collect();
        groups.insert(name.to_owned(), rest);
    }
}

fn union(groups: &Groups, names: &[&str]) -> Option<Vec<u32>> {
    let parts: Vec<&Vec<u32>> = names.iter().map(|name| groups.get(*name)).collect::<Option<_>>()?;
    Some(sorted(parts.into_iter().flatten().copied().collect()))
}

fn sorted(mut vertices: Vec<u32>) -> Vec<u32> {
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// The vertices at most so many edges away.
fn at_most(distances: &[Option<u32>], edges: u32) -> Vec<u32> {
    let near =
        (0..).zip(distances).filter(|(_, distance)| distance.is_some_and(|distance| distance <= edges));
    near.map(|(v, _)| v).collect()
}

/// The closed boundaries of a mesh: chains of edges that only one triangle has.
fn boundaries(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let edges = |[a, b, c]: &[u32; 3]| [[*a, *b], [*b, *c], [*c, *a]];
    let all: BTreeSet<[u32; 2]> = triangles.iter().flat_map(edges).collect();
    let mut next: BTreeMap<u32, u32> =
        all.iter().filter(|[a, b]| !all.contains(&[*b, *a])).map(|[a, b]| (*a, *b)).collect();
    let mut loops = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut chain = Vec::new();
        let mut at = start;
        while let Some(after) = next.remove(&at) {
            chain.push(at);
            at = after;
        }
        if at == start {
            loops.push(chain);
        }
    }
    loops
}

struct Mesh<'a> {
    template: &'a [Vec3],
    neighbours: Vec<BTreeSet<u32>>,
}

impl<'a> Mesh<'a> {
    fn new(template: &'a [Vec3], triangles: &[[u32; 3]]) -> Self {
        let mut neighbours = vec![BTreeSet::new(); template.len()];
        for [a, b, c] in triangles {
            for (v, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                neighbours[*v as usize].extend(others.map(|other| *other));
            }
        }
        Self { template, neighbours }
    }

    fn mean(&self, vertices: &[u32]) -> Vec3 {
        vertices.iter().map(|v| self.template[*v as usize]).sum::<Vec3>() / vertices.len().max(1) as f32
    }

    /// Edges from `start` to each vertex; `None` for those that no path leads to.
    fn distances(&self, start: &[u32]) -> Vec<Option<u32>> {
        let mut distances = vec![None; self.template.len()];
        start.iter().for_each(|v| distances[*v as usize] = Some(0));
        let mut front = start.to_vec();
        let mut edges = 0;
        while !front.is_empty() {
            edges += 1;
            let mut next = Vec::new();
            for other in front.iter().flat_map(|v| &self.neighbours[*v as usize]) {
                let distance = &mut distances[*other as usize];
                if distance.is_none() {
                    *distance = Some(edges);
                    next.push(*other);
                }
            }
            front = next;
        }
        distances
    }

    /// The vertices `edges` away, in the order of `ring`, the vertices one edge nearer: each beside its own, in sum as near as possible. `None`
    /// if they are not a closed ring of as many.
    fn ring_beside(&self, distances: &[Option<u32>], edges: u32, ring: &[u32]) -> Option<Vec<u32>> {
        if ring.is_empty() || ring.len() > LONGEST_RING {
            return None;
        }
        let is_in = |v: &u32| distances[*v as usize] == Some(edges);
        let start = (0..distances.len() as u32).find(|v| is_in(v))?;
        let mut chain = vec![start];
        while chain.len() < ring.len() {
            let at = chain[chain.len() - 1];
            let before = chain.len().checked_sub(2).map(|before| chain[before]);
            let next = self.neighbours[at as usize]
                .iter()
                .find(|v| is_in(v) && Some(**v) != before && **v != start)?;
            if chain.contains(next) {
                return None;
            }
            chain.push(*next);
        }
        let closes = self.neighbours[chain[chain.len() - 1] as usize].contains(&start);
        let count = (0..distances.len() as u32).filter(|v| is_in(v)).count();
        if !closes || count != ring.len() {
            return None;
        }
        let far = |beside: &[u32]| {
            let pairs = ring.iter().zip(beside);
            pairs.map(|(a, b)| self.template[*a as usize].distance(self.template[*b as usize])).sum::<f32>()
        };
        let mut nearest = chain.clone();
        for _ in 0..2 {
            for _ in 0..chain.len() {
                chain.rotate_left(1);
                if far(&chain) < far(&nearest) {
                    nearest.clone_from(&chain);
                }
            }
            chain.reverse();
        }
        Some(nearest)
    }
}
