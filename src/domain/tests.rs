//! Every domain against sums over many of its points, which its map alone makes.

use proptest::prelude::*;

use super::*;

/// Points of a domain that sums are over.
const COUNT: usize = 160_000;

/// Densities with empty parts (of the first row, of whole rows and columns, of all but two pixels) and
/// without.
pub(crate) fn densities() -> [Domain; 3] {
    let make = |name, [width, height]: [usize; 2], level: &dyn Fn(usize, usize) -> usize| {
        let level = |i: usize| level(i % width, i / width) as f64;
        let levels: Vec<f64> = (0..width * height).map(level).collect();
        Domain::Density(Density::new(name, [width, height], &levels).unwrap())
    };
    let island = |x: usize, y: usize| match (x, y) {
        (3..=8, 2..=9) => 1 + (x * y) % 5,
        (11, _) | (13, 12) => 3,
        _ => 0,
    };
    [
        make("islands", [14, 13], &island),
        make("slope", [7, 5], &|x, y| 1 + x + 2 * x * y),
        make("two", [2, 3], &|x, y| usize::from(x + y == 1)),
    ]
}

/// All domains but the square, densities among them.
pub(crate) fn domains() -> impl Iterator<Item = Domain> {
    Domain::ALL.into_iter().filter(|domain| !domain.is_square()).chain(densities())
}

fn shapes() -> impl Iterator<Item = (Domain, &'static dyn Shape)> {
    domains().map(|domain| (domain, domain.known()))
}

/// Points of the golden ratio's lattice in the square, mapped.
fn points(shape: &'static dyn Shape) -> Vec<[f64; 3]> {
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    (0..COUNT)
        .map(|i| shape.point([(i as f64 + 0.5) / COUNT as f64, (i as f64 * ratio).fract()]))
        .collect()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Unit vectors in the dimensions of a shape, the axes among them.
fn directions(dims: usize) -> Vec<[f64; 3]> {
    let mut all: Vec<[f64; 3]> =
        (0..dims).map(|k| std::array::from_fn(|i| f64::from(u8::from(i == k)))).collect();
    for i in 0..12 {
        let i = f64::from(i);
        let mut theta = [libm::sin(1.0 + 3.0 * i), libm::cos(2.0 + 5.0 * i), libm::sin(4.0 * i)];
        theta[dims..].fill(0.0);
        let length = dot(theta, theta).sqrt();
        all.push(theta.map(|x| x / length));
    }
    all
}

#[test]
fn points_are_of_the_domain_and_have_its_moments() {
    for (domain, shape) in shapes() {
        let points = points(shape);
        let count = points.len() as f64;
        for k in 0..3 {
            let mean = points.iter().map(|point| point[k]).sum::<f64>() / count;
            let square = points.iter().map(|point| point[k] * point[k]).sum::<f64>() / count;
            assert!((mean - shape.mean()[k]).abs() < 1e-4, "{domain} {k}: {mean}");
            let variance = square - mean * mean;
            assert!((variance - shape.variances()[k]).abs() < 1e-4, "{domain} {k}: {variance}");
        }
        for point in points {
            let length = dot(point, point).sqrt();
            match shape.surface() {
                Surface::Cube | Surface::Mask(_) => {
                    assert!(point.iter().all(|x| x.abs() <= 1.0));
                }
                Surface::Ball => assert!(length <= 1.0 + 1e-12),
                _ => assert!((length - 1.0).abs() < 1e-12),
            }
            assert!(shape.surface() != Surface::Hemisphere || point[2] >= 0.0);
        }
    }
}

#[test]
fn shares_of_half_spaces_are_those_of_many_points() {
    for (domain, shape) in shapes() {
        let points = points(shape);
        for theta in directions(shape.dims()) {
            for t in [-0.93, -0.4, 0.0, 0.11, 0.5, 0.99] {
                let below = points.iter().filter(|&&point| dot(point, theta) < t).count();
                let expected = below as f64 / points.len() as f64;
                let found = shape.below(theta, t);
                // Cells of the square that the border goes through are two in a row or so.
                assert!(
                    (found - expected).abs() < 2e-3,
                    "{domain} {theta:?} {t}: {found} {expected}"
                );
            }
            assert!(shape.below(theta, -1.5).abs() < 1e-12, "{domain}");
            assert!((shape.below(theta, 1.5) - 1.0).abs() < 1e-12, "{domain}");
        }
    }
}

#[test]
fn shares_of_balls_are_those_of_many_points() {
    for (domain, shape) in shapes() {
        let points = points(shape);
        for centre in [[0.1, 0.2], [0.5, 0.5], [0.93, 0.01], [0.3, 0.99]].map(|u| shape.point(u)) {
            for radius in [0.1, 0.45, 1.0, 1.3] {
                let within = points.iter().filter(|&&point| distance(point, centre) < radius);
                let expected = within.count() as f64 / points.len() as f64;
                let found = shape.within(centre, radius);
                assert!((found - expected).abs() < 5e-4, "{domain} {radius}: {found} {expected}");
            }
            assert_eq!(shape.within(centre, 0.0), 0.0, "{domain}");
            assert!((shape.within(centre, 3.0) - 1.0).abs() < 1e-12, "{domain}");
        }
    }
}

/// The part of a gradient that leads along a surface.
fn along(shape: &'static dyn Shape, x: [f32; 3], gradient: [f32; 3]) -> [f32; 3] {
    let (planes, mut along) = (x.map(|x| [x]), gradient.map(|g| [g]));
    if shape.dims() == 2 {
        let mut flat = [along[0], along[1]];
        shape.surface().flatten(&[planes[0], planes[1]], &mut flat);
        return [flat[0][0], flat[1][0], 0.0];
    }
    shape.surface().flatten(&planes, &mut along);
    along.map(|[g]| g)
}

#[test]
fn a_pull_is_the_gradient_of_the_mean_distance() {
    for (domain, shape) in shapes() {
        let pull = domain.pull();
        let points = points(shape);
        for place in [[0.52, 0.47], [0.3, 0.8], [0.05, 0.6]] {
            let at = shape.point(place);
            let mut expected = [0.0; 3];
            for point in &points {
                let away = distance(at, *point);
                for k in 0..3 {
                    expected[k] += (at[k] - point[k]) / (away.max(1e-9) * points.len() as f64);
                }
            }
            let x = at.map(|y| (0.5 + 0.5 * y) as f32);
            let plane = [x[0], x[1]];
            let mut found = match &pull {
                Pull::Even(even) => panic!("{domain}: {even:?}"),
                Pull::Chords(attraction) if shape.dims() == 3 => attraction.gradient(x),
                Pull::Chords(attraction) => with_zero(attraction.gradient(plane)),
                Pull::Uneven(uneven) => with_zero(uneven.gradient(plane)),
            };
            let mut expected = expected.map(|x| x as f32);
            // On a surface only what leads along it is asked for.
            if shape.surface().is_curved() {
                found = along(shape, x, found);
                expected = along(shape, x, expected);
            }
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 6e-3, "{domain} {place:?}: {found} {expected}");
            }
            let Pull::Uneven(uneven) = &pull else { continue };
            // Of each coordinate alone: the share on one side against that on the other, where samples
            // of half the mean density count half; and half the squared distance.
            for k in 0..2 {
                let below = points.iter().filter(|point| point[k] < at[k]).count() as f64;
                let share = 2.0 * below / points.len() as f64 - 1.0;
                let near = |x: f64| {
                    let near = points.iter().filter(|point| (point[k] - x).abs() < 0.02).count();
                    near as f64 / points.len() as f64 / 0.02
                };
                let mean = points.iter().step_by(97).map(|point| near(point[k]));
                let mean = mean.sum::<f64>() / points.len().div_ceil(97) as f64;
                let expected =
                    0.3 * share * near(at[k]) / mean + 0.7 * (0.5 * at[k] - 0.5 * shape.mean()[k]);
                let found = f64::from(uneven.sides(plane, 0.3, 0.7)[k]);
                assert!((found - expected).abs() < 2e-2, "{domain} {place:?}: {found} {expected}");
            }
        }
    }
}

fn with_zero([a, b]: [f32; 2]) -> [f32; 3] {
    [a, b, 0.0]
}

#[test]
fn a_distribution_on_a_grid_has_the_integrals_of_its_inverse() {
    for domain in domains() {
        let dims = domain.dims().unwrap();
        for theta in directions(dims) {
            let theta: Vec<f32> = theta[..dims].iter().map(|&x| x as f32).collect();
            let mut integrals = vec![0.0; 9];
            domain.cdf(&theta).integrate_inverse(8, &mut integrals);
            // The whole integral is the mean, and means over ranks are quantiles between their ends.
            let centred = |k: usize| f64::from(theta[k]) * (domain.moments(dims)[k].0 - 0.5);
            let mean: f64 = (0..dims).map(centred).sum();
            assert!((integrals[8] - integrals[0] - mean).abs() < 1e-5, "{domain} {theta:?}");
            let wide: Vec<f64> = theta.iter().map(|&x| f64::from(x)).collect();
            let middle = 0.5 * wide.iter().sum::<f64>();
            for (rank, ends) in integrals.windows(2).enumerate() {
                let share = domain.below(&wide, middle + 8.0 * (ends[1] - ends[0]));
                // (Where there is nothing for a while, rounding decides what is below.)
                let range = rank as f64 / 8.0 - 2e-3..(rank + 1) as f64 / 8.0 + 2e-3;
                assert!(range.contains(&share), "{domain} {theta:?} {rank}: {share}");
            }
        }
    }
}

proptest! {
    #[test]
    fn a_place_is_found_again(u in 0.001_f64..0.999, v in 0.001_f64..0.999) {
        for (domain, shape) in shapes() {
            let place = if shape.parameters() == 1 { [u, 0.0] } else { [u, v] };
            let found = shape.place(shape.point(place));
            for (found, expected) in found.into_iter().zip(place) {
                prop_assert!((found - expected).abs() < 1e-6, "{}: {} {}", domain, found, expected);
            }
        }
    }

    #[test]
    fn what_comes_back_is_of_the_domain_and_stays(
        x in prop::array::uniform3(prop_oneof![-2.0_f32..3.0, Just(0.5), Just(-0.0)]),
    ) {
        for domain in Domain::ALL.into_iter().chain(densities()) {
            let dims = domain.dims().unwrap_or(3);
            let mut point = x[..dims].to_vec();
            domain.surface().bring_all_back(&mut point, dims);
            prop_assert!(point.iter().all(|x| (0.0..1.0).contains(x)), "{}: {:?}", domain, point);
            let tile = with_dims(TileShape::new(1, 1, 1, 1, 1).unwrap(), dims, point.clone());
            prop_assert_eq!(domain.adopt(&tile), Ok(tile));
            let length = point.iter().map(|x| (x - 0.5) * (x - 0.5)).sum::<f32>().sqrt();
            match domain.surface() {
                Surface::Cube => (),
                Surface::Mask(mask) => prop_assert!(mask.contains([point[0], point[1]])),
                Surface::Ball => prop_assert!(length < 0.5 + 1e-6),
                _ => prop_assert!((length - 0.5).abs() < 1e-6, "{}: {:?}", domain, point),
            }
            prop_assert!(domain.surface() != Surface::Hemisphere || point[2] >= 0.5);
        }
    }

    #[test]
    fn a_tangent_leads_along_the_surface(u in 0.0_f64..1.0, v in 0.0_f64..1.0) {
        for (domain, shape) in shapes().filter(|(_, shape)| shape.surface().is_curved()) {
            let mut point = [0.5; 3];
            domain.point(&[u, v], &mut point[..shape.dims()]);
            let gradient = along(shape, point, [0.3, -0.7, 0.2]);
            let away: f32 = point.iter().zip(gradient).map(|(x, g)| (x - 0.5) * g).sum();
            prop_assert!(away.abs() < 1e-6);
        }
    }
}

#[test]
fn names_are_read_again_and_dimensions_checked() {
    for domain in Domain::ALL {
        assert_eq!(domain.to_string().parse(), Ok(domain));
    }
    let error = "ball".parse::<Domain>().unwrap_err().to_string();
    assert!(error.contains("`ball` is no domain; there are: square, circle"), "{error}");
    let error = Domain::Sphere.check(2).unwrap_err().to_string();
    assert_eq!(error, "a sample of the domain `sphere` has 3 dimensions, not 2");
    let tile = |samples: &[f32]| {
        let shape = TileShape::new(samples.len() / 2, 1, 1, 1, 2).unwrap();
        Tile::new(shape, samples.to_vec()).unwrap()
    };
    let outside = Domain::Disk.adopt(&tile(&[0.5, 0.5, 0.9, 0.9])).unwrap_err().to_string();
    assert!(outside.contains("sample 1 is [0.9, 0.9]"), "{outside}");
    // What 8 bits do to a point at an angle of 45 degrees is taken back.
    let back = Domain::Circle.adopt(&tile(&[0.8535 + 0.002, 0.8535 + 0.002])).unwrap();
    assert!(back.samples().iter().all(|x| (x - 0.853_553_4).abs() < 1e-6), "{back:?}");
}

/// The pixel of a density that a point is in, asked of exact quotients.
fn level_at(picture: &picture::Picture, point: [f32; 2]) -> f32 {
    let index = |x: f32, n: usize| {
        (0..n).rev().find(|&i| f64::from(x) * n as f64 >= i as f64).unwrap_or_default()
    };
    let [width, height] = picture.size();
    picture.levels()[index(point[1], height) * width + index(point[0], width)]
}

#[test]
fn no_point_of_a_density_is_where_it_is_empty() {
    for domain in densities() {
        let Domain::Density(density) = domain else { panic!() };
        let picture = density.picture();
        // Corners of pixels are where rounding could put a point into the next one.
        for i in 0..=400 {
            for j in 0..=400 {
                let mut point = [0.0; 2];
                domain.point(&[f64::from(i) / 400.0, f64::from(j) / 400.0], &mut point);
                assert!(level_at(picture, point) > 0.0, "{domain}: {point:?}");
                let mut back = [i as f32 / 400.0, j as f32 / 400.0];
                domain.surface().bring_all_back(&mut back, 2);
                assert!(level_at(picture, back) > 0.0, "{domain}: {back:?}");
            }
        }
    }
}

/// From an empty pixel beside a full one to the nearest point, from others to the nearest pixel.
#[test]
fn samples_come_back_to_what_is_nearest() {
    for domain in densities() {
        let Domain::Density(density) = domain else { panic!() };
        let (picture, [width, height]) = (density.picture(), density.size());
        let is_full = |x: usize, y: usize| picture.levels()[y * width + x] > 0.0;
        // How far a point is from a pixel, or from its middle.
        let away = |[x, y]: [f64; 2], [i, j]: [usize; 2], to_middle: bool| {
            let along = |x: f64, i: usize, n: usize| {
                let (low, high) = (i as f64 / n as f64, (i + 1) as f64 / n as f64);
                x - if to_middle { 0.5 * (low + high) } else { x.clamp(low, high) }
            };
            along(x, i, width).hypot(along(y, j, height))
        };
        let full = || {
            let all = (0..width * height).map(|i| [i % width, i / width]);
            all.filter(|&[i, j]| is_full(i, j))
        };
        for place in 0..71 * 67 {
            let point = [(place % 71) as f64 / 70.5, (place / 71) as f64 / 66.5];
            let mut back = point.map(|x| x as f32);
            domain.surface().bring_all_back(&mut back, 2);
            let found = (f64::from(back[0]) - point[0]).hypot(f64::from(back[1]) - point[1]);
            let here = [(point[0] * width as f64) as usize, (point[1] * height as f64) as usize];
            let beside = full().filter(|[i, j]| i.abs_diff(here[0]) < 2 && j.abs_diff(here[1]) < 2);
            let least = beside.map(|pixel| away(point, pixel, false)).fold(f64::MAX, f64::min);
            if least < f64::MAX {
                assert!((found - least).abs() < 1e-6, "{domain} {point:?}: {back:?}");
                continue;
            }
            let middle = [0, 1].map(|k| (here[k] as f64 + 0.5) / [width, height][k] as f64);
            let least = full().map(|pixel| away(middle, pixel, true)).fold(f64::MAX, f64::min);
            let index = |x: f32, n: usize| (f64::from(x) * n as f64) as usize;
            let pixel = [index(back[0], width), index(back[1], height)];
            assert!((away(middle, pixel, true) - least).abs() < 1e-9, "{domain} {point:?}");
        }
    }
}

/// Samples that enter a density stay apart; those that move slide along what is empty, or stay.
#[test]
fn samples_neither_gather_on_borders_nor_leave() {
    for domain in densities() {
        let Surface::Mask(mask) = domain.surface() else { continue };
        assert_eq!(domain.surface_on_the_way(), Surface::Cube);
        // Along a line that leads from an empty part into a full one.
        for row in [0.05_f32, 0.4, 0.7, 0.95] {
            let mut before = None;
            for i in 0..2000 {
                let point = [(i as f32 + 0.5) / 2000.0, row];
                let entered = mask.enter(point);
                assert!(mask.contains(entered), "{domain} {point:?}: {entered:?}");
                assert!(Some(entered) != before, "{domain} {point:?}: {entered:?} twice");
                if mask.contains(point) {
                    assert_eq!(entered, point);
                }
                before = Some(entered);
                for to in [[0.3, 0.6], [point[0], 0.1], [0.99, 0.99]] {
                    let settled = mask.settle(entered, to);
                    assert!(mask.contains(settled), "{domain} {entered:?} {to:?}: {settled:?}");
                    assert!(settled == to || !mask.contains(to));
                    assert!((0..2).all(|k| settled[k] == to[k] || settled[k] == entered[k]));
                }
            }
        }
    }
}

/// What rounding to 8 and 16 bits does to any point is taken back.
#[test]
fn rounded_points_of_a_density_are_adopted() {
    let make =
        |name, size, levels: &[f64]| Domain::Density(Density::new(name, size, levels).unwrap());
    let disk = |n: usize| -> Vec<f64> {
        let at = |i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
        (0..n * n).map(|i| f64::from(u8::from(at(i % n).hypot(at(i / n)) < 0.45))).collect()
    };
    for domain in densities().into_iter().chain([
        make("gap", [3, 1], &[1.0, 0.0, 1.0]),
        make("disk", [100, 100], &disk(100)),
        make("fine", [700, 700], &disk(700)),
    ]) {
        let mut samples = Vec::new();
        for i in 0..300 * 300 {
            let mut point = [0.0; 2];
            let place = [f64::from(i % 300) / 299.0, f64::from(i / 300) / 299.0];
            domain.point(&place, &mut point);
            for levels in [256.0, 65536.0] {
                samples.extend(point.map(|x| ((x * levels).floor() + 0.5) / levels));
            }
        }
        let shape = TileShape::new(600, 300, 1, 1, 2).unwrap();
        let adopted = domain.adopt(&Tile::new(shape, samples).unwrap());
        assert!(adopted.is_ok(), "{domain}: {:?}", adopted.err());
    }
    // Two lone pixels, as far from the one that a rounded sample is in: its own one is nearer to it.
    const SIZE: usize = 700;
    let rounded = |level: usize| (level as f32 + 0.5) / 256.0;
    let place = |level: usize| rounded(level) * SIZE as f32;
    let level = (2..250).find(|&level| place(level).fract() > 0.95).unwrap();
    let pixel = place(level) as usize;
    let mut levels = vec![0.0; SIZE * SIZE];
    for at in [pixel - 2, pixel + 2] {
        levels[at * SIZE + at] = 1.0;
    }
    let shape = TileShape::new(1, 1, 1, 1, 2).unwrap();
    let tile = Tile::new(shape, vec![rounded(level); 2]).unwrap();
    assert!(make("lone", [SIZE, SIZE], &levels).adopt(&tile).is_ok());
}

/// The last coordinate of a column is one of that column.
#[test]
fn coordinates_at_borders_have_the_density_of_their_own_column() {
    const COLUMNS: usize = 1000;
    let levels: Vec<f64> = (0..COLUMNS).map(|i| (i % 2) as f64).collect();
    let domain = Domain::Density(Density::new("comb", [COLUMNS, 1], &levels).unwrap());
    let (Pull::Uneven(uneven), Surface::Mask(mask)) = (domain.pull(), domain.surface()) else {
        panic!()
    };
    for column in (2..COLUMNS).step_by(2) {
        for inside in [0.1, 0.9] {
            let point = mask.bring_back([(column as f32 + inside) / COLUMNS as f32, 0.5]);
            assert!(uneven.densities(point)[0] > 0.0, "{column} {inside}: {point:?}");
        }
    }
}

/// Pictures whose sides differ as much as may be are no more work than others.
#[test]
fn long_pictures_are_densities_as_well() {
    let mut levels = vec![0.0; MAX_PIXELS];
    levels[MAX_PIXELS - 1] = 1.0;
    for (size, axis) in [([MAX_PIXELS, 1], 0), ([1, MAX_PIXELS], 1)] {
        let domain = Domain::Density(Density::new("long", size, &levels).unwrap());
        let mut point = [0.25; 2];
        domain.surface().bring_all_back(&mut point, 2);
        assert!(point[axis] >= 1.0 - 1.0 / MAX_PIXELS as f32 && point[1 - axis] == 0.25);
        let mut theta = [0.0; 2];
        theta[axis] = 1.0;
        assert_eq!(domain.cdf(&theta).at(0.0), 0.0);
        theta[axis] = -1.0;
        assert!((domain.cdf(&theta).at(-0.25) - 1.0).abs() < 1e-12);
    }
}

/// Shares are exact: sums over pixels that are cut finely are as close as their number says.
#[test]
fn shares_of_a_density_are_sums_over_its_pixels() {
    for domain in densities() {
        let Domain::Density(density) = domain else { panic!() };
        let (picture, [width, height]) = (density.picture(), density.size());
        let fine = 600 / width.max(height);
        let total: f64 = picture.levels().iter().map(|&level| f64::from(level)).sum();
        let sum = |value: &dyn Fn(f64, f64) -> f64| -> f64 {
            let mut sum = 0.0;
            for (i, &level) in
                picture.levels().iter().enumerate().filter(|(_, level)| **level > 0.0)
            {
                for j in 0..fine * fine {
                    let x = ((i % width) as f64 + ((j % fine) as f64 + 0.5) / fine as f64)
                        / width as f64;
                    let y = ((i / width) as f64 + ((j / fine) as f64 + 0.5) / fine as f64)
                        / height as f64;
                    sum += f64::from(level) * value(x, y) / (fine * fine) as f64;
                }
            }
            sum / total
        };
        for theta in directions(2) {
            for offset in [0.31, 0.5, 0.77] {
                let expected =
                    sum(&|x, y| f64::from(u8::from(theta[0] * x + theta[1] * y < offset)));
                let found = domain.below(&theta[..2], offset);
                assert!((found - expected).abs() < 4e-3, "{domain} {theta:?}: {found} {expected}");
                // The same from the other side.
                let turned = theta.map(|x| -x);
                assert!((1.0 - domain.below(&turned[..2], -offset) - found).abs() < 1e-12);
                // The table is linear between its nodes.
                let narrow: Vec<f32> = theta[..2].iter().map(|&x| x as f32).collect();
                let at = offset - 0.5 * (theta[0] + theta[1]);
                let of_table = domain.cdf(&narrow).at(at);
                assert!((of_table - found).abs() < 1e-4, "{domain} {theta:?}: {of_table} {found}");
            }
        }
        for centre in [[0.2, 0.6], [0.81, 0.93]] {
            let from = |x: f64, y: f64| (x - centre[0]).hypot(y - centre[1]);
            for radius in [0.04, 0.3, 0.8] {
                let expected = sum(&|x, y| f64::from(u8::from(from(x, y) < radius)));
                let found = domain.within(&centre, radius);
                assert!((found - expected).abs() < 2e-3, "{domain} {radius}: {found} {expected}");
                let expected = sum(&|x, y| (-0.5 * (from(x, y) / radius).powi(2)).exp());
                let found = domain.gaussian(&centre, radius);
                assert!((found - expected).abs() < 2e-4, "{domain} {radius}: {found} {expected}");
            }
        }
        for theta in directions(2) {
            let at = |x: f64, y: f64| theta[0] * x + theta[1] * y;
            let (mean, variance) = domain.along(&theta[..2]);
            let expected = sum(&at);
            assert!((mean - expected).abs() < 1e-9, "{domain}: {mean} {expected}");
            let expected = sum(&|x, y| (at(x, y) - mean) * (at(x, y) - mean));
            assert!((variance - expected).abs() < 1e-4, "{domain}: {variance} {expected}");
        }
    }
}

#[test]
fn a_density_is_kept_once_and_travels_whole() {
    let [domain, other, _] = densities();
    let Domain::Density(density) = domain else { panic!() };
    let levels: Vec<f64> = density.picture().levels().iter().map(|&x| 7.0 * f64::from(x)).collect();
    let same = Density::new("islands", density.size(), &levels).unwrap();
    assert_eq!(same, density);
    assert_ne!(Density::new("another", density.size(), &levels).unwrap(), density);
    assert_eq!(domain.to_string(), "density(islands)");
    assert_eq!("density(a.png)".parse(), Ok(DomainSpec::File("a.png".to_owned())));
    assert!("density()".parse::<DomainSpec>().is_err());
    // People read its name, programs all of it.
    let json = serde_json::to_value(domain).unwrap();
    assert_eq!(json["density"]["name"], "islands");
    assert_eq!(json["density"]["sha256"], density.sha256());
    for domain in [Domain::Cosine, domain, other] {
        let bytes = perceptile_cluster::codec::encode(&domain).unwrap();
        assert_eq!(
            perceptile_cluster::codec::decode::<Domain, { 1 << 20 }>(&bytes).unwrap(),
            domain
        );
    }
}
