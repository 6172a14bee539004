use super::*;
use crate::Packed;
use crate::bf16::add_products;

const ROWS: usize = 11;
const DEPTH: usize = 7;

fn numbers(len: usize, seed: usize) -> Vec<f32> {
    (0..len).map(|i| ((i * 7919 + seed * 104_729) % 1000) as f32 / 500.0 - 1.0).collect()
}

/// `[depth, columns]` in panels; missing columns of the last one are zero.
fn panels(isa: Isa, right: &[f32], columns: usize) -> Vec<f32> {
    let width = panel_columns(isa);
    let depth = right.len() / columns;
    let mut panels = vec![0.0; columns.next_multiple_of(width) * depth];
    for (row, values) in right.chunks_exact(columns).enumerate() {
        for (x, &value) in values.iter().enumerate() {
            panels[(x / width * depth + row) * width + x % width] = value;
        }
    }
    panels
}

#[test]
fn products_are_the_sums_of_their_definition() {
    for isa in Isa::to_test() {
        let width = panel_columns(isa);
        for columns in [1, width - 1, width, 2 * width + 5] {
            let (left, right) = (numbers(ROWS * DEPTH, 1), numbers(DEPTH * columns, 2));
            let (start, add) = (numbers(ROWS, 3), numbers(ROWS * columns, 4));
            let packed = Packed::rows(isa, Precision::F32, &left, DEPTH);
            let panels = panels(isa, &right, columns);
            let steps = Steps { row: columns, panel: width };
            let product = Product {
                left: packed.part(0),
                rows: ROWS,
                depth: DEPTH,
                right: Right::F32(&panels),
                right_panel: DEPTH * width,
                start: Start::PerRow(&start),
                add: Some((&add, steps)),
                activation: Activation::Relu,
                columns,
            };
            let mut out = vec![f32::NAN; ROWS * columns];
            multiply(isa, &product, &mut Output::new(&mut out, steps));
            for (i, found) in out.iter().enumerate() {
                let (row, x) = (i / columns, i % columns);
                let terms =
                    (0..DEPTH).map(|k| f64::from(left[row * DEPTH + k]) * f64::from(right[k * columns + x]));
                let expected = (f64::from(start[row] + add[i]) + terms.sum::<f64>()).max(0.0);
                assert!((f64::from(*found) - expected).abs() < 1e-5, "{isa:?}: {found} for {expected}");
            }

            let diagonal = Product { rows: DEPTH, ..product };
            let mut out = vec![f32::NAN; DEPTH * columns];
            multiply_diagonal(isa, &start[..DEPTH], &diagonal, &mut Output::new(&mut out, steps));
            for (i, found) in out.iter().enumerate() {
                let factor = f64::from(start[i / columns]);
                let expected = factor * f64::from(right[i]) + factor + f64::from(add[i]);
                assert!((f64::from(*found) - expected.max(0.0)).abs() < 1e-5, "{isa:?}: {found}");
            }
        }
    }
}

#[test]
fn products_of_bfloat16_have_the_bits_of_their_definition() {
    for isa in Isa::to_test() {
        let width = panel_columns(isa);
        // The last one makes sums that are not normal numbers.
        for (columns, scale) in [(1, 1.0), (width, 3.0), (2 * width + 5, 1.0), (width, 3e-20)] {
            let scaled = |numbers: Vec<f32>| numbers.into_iter().map(|x| x * scale).collect::<Vec<f32>>();
            let (left, right) = (scaled(numbers(ROWS * DEPTH, 1)), scaled(numbers(DEPTH * columns, 2)));
            let start: Vec<f32> = scaled(scaled(numbers(ROWS, 3)));
            let packed = Packed::rows(isa, Precision::Bf16, &left, DEPTH);
            let steps = Steps { row: columns, panel: width };
            let product = Product {
                left: packed.part(0),
                rows: ROWS,
                depth: DEPTH,
                right: Right::F32(&panels(isa, &right, columns)),
                right_panel: DEPTH * width,
                start: Start::PerRow(&start),
                add: None,
                activation: Activation::Identity,
                columns,
            };
            let mut out = vec![f32::NAN; ROWS * columns];
            multiply(isa, &product, &mut Output::new(&mut out, steps));
            for (i, found) in out.iter().enumerate() {
                let (row, x) = (i / columns, i % columns);
                let factor = |k: usize| if k < DEPTH { left[row * DEPTH + k] } else { 0.0 };
                let other = |k: usize| if k < DEPTH { right[k * columns + x] } else { 0.0 };
                let expected = (0..DEPTH).step_by(2).fold(start[row], |sum, k| {
                    let pair = Pair::new(factor(k), factor(k + 1));
                    add_products(sum, pair, Pair::new(other(k), other(k + 1)))
                });
                assert_eq!(found.to_bits(), expected.to_bits(), "{isa:?}: {found} for {expected}");
            }
        }
    }
}

/// Rounding before or after a product, in the kernel or outside of it, gives the same bits.
#[test]
fn pairs_on_the_right_and_in_the_output_are_those_of_rounding() {
    for isa in Isa::to_test() {
        let width = panel_columns(isa);
        let columns = 2 * width;
        let (left, right) = (numbers(ROWS * DEPTH, 1), numbers(DEPTH * columns, 2));
        let (start, add) = (numbers(ROWS, 3), numbers(ROWS * columns, 4));
        let packed = Packed::rows(isa, Precision::Bf16, &left, DEPTH);
        let (panels, steps) = (panels(isa, &right, columns), Steps { row: width, panel: ROWS * width });
        let product = Product {
            left: packed.part(0),
            rows: ROWS,
            depth: DEPTH,
            right: Right::F32(&panels),
            right_panel: DEPTH * width,
            start: Start::PerRow(&start),
            add: Some((&add, steps)),
            activation: Activation::Gelu,
            columns,
        };
        let rounded = |panels: &[f32], rows: usize| {
            let panel = Precision::Bf16.packed(rows) * width;
            let mut pairs = vec![Pair::default(); 2 * panel];
            for (pairs, panel) in pairs.chunks_exact_mut(panel).zip(panels.chunks_exact(rows * width)) {
                pair_rows(isa, panel, width, pairs);
            }
            (pairs, panel)
        };
        let mut expected = vec![f32::NAN; ROWS * columns];
        multiply(isa, &product, &mut Output::new(&mut expected, steps));

        let (pairs, panel) = rounded(&panels, DEPTH);
        let of_pairs = Product { right: Right::Bf16(&pairs), right_panel: panel, ..product };
        let mut found = vec![f32::NAN; ROWS * columns];
        multiply(isa, &of_pairs, &mut Output::new(&mut found, steps));
        assert_eq!(found, expected, "{isa:?}");

        let (expected, panel) = rounded(&expected, ROWS);
        let mut found = vec![Pair::new(f32::NAN, f32::NAN); 2 * panel];
        multiply_to_pairs(isa, &of_pairs, &mut found, panel);
        assert_eq!(found, expected, "{isa:?}");
        let short = std::panic::catch_unwind(move || {
            multiply_to_pairs(isa, &of_pairs, &mut found[1..], panel);
        });
        assert!(short.is_err(), "{isa:?}: an output that is too short");
    }
}

/// Every slice panics when it is one element too short; nothing is read or written out of bounds.
#[test]
fn slices_that_are_too_short_are_refused() {
    let isa = Isa::best();
    let width = panel_columns(isa);
    let columns = width + 3;
    let steps = Steps { row: columns, panel: width };
    let full = [ROWS * DEPTH, DEPTH * 2 * width, ROWS, ROWS * columns, ROWS * columns];
    let run = |[left, right, start, add, out]: [usize; 5]| {
        let (left, right) = (vec![0.0; left], vec![0.0; right]);
        let (start, add, mut out) = (vec![0.0; start], vec![0.0; add], vec![0.0; out]);
        let product = Product {
            left: Left::F32(&left),
            rows: ROWS,
            depth: DEPTH,
            right: Right::F32(&right),
            right_panel: DEPTH * width,
            start: Start::PerRow(&start),
            add: Some((&add, steps)),
            activation: Activation::Identity,
            columns,
        };
        std::panic::catch_unwind(move || multiply(isa, &product, &mut Output::new(&mut out, steps)))
    };
    assert!(run(full).is_ok());
    for side in 0..full.len() {
        let mut short = full;
        short[side] -= 1;
        assert!(run(short).is_err(), "side {side}");
    }
}

/// Panels that share their memory claim any number of columns.
fn multiply_shared_panels(columns: usize) {
    let isa = Isa::best();
    let (left, right) = (vec![Pair::default(); 4 * isa.tile_rows()], vec![0.0; 4 * panel_columns(isa)]);
    let product = Product {
        left: Left::Bf16(&left),
        rows: 1,
        depth: 4,
        right: Right::F32(&right),
        right_panel: 0,
        start: Start::Zero,
        add: None,
        activation: Activation::Identity,
        columns,
    };
    multiply(isa, &product, &mut Output::new(&mut vec![0.0; 200], Steps { row: 0, panel: 0 }));
}

#[test]
#[should_panic(expected = "larger than memory")]
fn sides_whose_rounded_copy_exceeds_the_address_space_are_refused() {
    multiply_shared_panels(usize::MAX / panel_columns(Isa::best()) * panel_columns(Isa::best()));
}

#[test]
#[should_panic(expected = "larger than memory")]
fn more_columns_than_whole_panels_can_hold_are_refused() {
    multiply_shared_panels(usize::MAX);
}

/// With AMX or without, in whole tiles, halves of them and what is left.
#[test]
fn long_products_of_bfloat16_are_the_sums_of_their_definition() {
    for isa in Isa::to_test() {
        let width = panel_columns(isa);
        for (rows, depth, columns) in
            [(8, 32, width), (21, 64, 5), (16, 131, 2 * width + 20), (9, 500, width)]
        {
            let (left, right) = (numbers(rows * depth, 1), numbers(depth * columns, 2));
            let start = numbers(rows, 3);
            let packed = Packed::rows(isa, Precision::Bf16, &left, depth);
            let steps = Steps { row: columns, panel: width };
            let product = Product {
                left: packed.part(0),
                rows,
                depth,
                right: Right::F32(&panels(isa, &right, columns)),
                right_panel: depth * width,
                start: Start::PerRow(&start),
                add: None,
                activation: Activation::Identity,
                columns,
            };
            let mut out = vec![f32::NAN; rows * columns];
            multiply(isa, &product, &mut Output::new(&mut out, steps));
            for (i, found) in out.iter().enumerate() {
                let (row, x) = (i / columns, i % columns);
                let rounded = |x: f32| f64::from(Pair::new(x, 0.0).factors()[0]);
                let term = |k: usize| rounded(left[row * depth + k]) * rounded(right[k * columns + x]);
                let expected = f64::from(start[row]) + (0..depth).map(term).sum::<f64>();
                let distance = (f64::from(*found) - expected).abs();
                assert!(
                    distance < 1e-6 * depth as f64,
                    "{isa:?}, {rows}x{depth}x{columns}: {found} for {expected}"
                );
            }
        }
    }
}
