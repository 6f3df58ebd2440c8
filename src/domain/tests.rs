//! Every domain against sums over many of its points, which its map alone makes.

use proptest::prelude::*;

use super::*;

/// Points of a domain that sums are over.
const COUNT: usize = 160_000;

fn shapes() -> impl Iterator<Item = (Domain, &'static dyn Shape)> {
    Domain::ALL.into_iter().filter_map(|domain| domain.shape().map(|shape| (domain, shape)))
}

/// Points of the golden ratio's lattice in the square, mapped.
fn points(shape: &dyn Shape) -> Vec<[f64; 3]> {
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
                let found = shape.below(theta[shape.dims() - 1], t);
                // Cells of the square that the border goes through are two in a row or so.
                assert!(
                    (found - expected).abs() < 2e-3,
                    "{domain} {theta:?} {t}: {found} {expected}"
                );
            }
            assert_eq!(shape.below(theta[shape.dims() - 1], -1.0), 0.0, "{domain}");
            assert_eq!(shape.below(theta[shape.dims() - 1], 1.0), 1.0, "{domain}");
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
            assert!((shape.within(centre, 2.0) - 1.0).abs() < 1e-12, "{domain}");
        }
    }
}

/// The part of a gradient that leads along a surface.
fn along(shape: &dyn Shape, x: [f32; 3], gradient: [f32; 3]) -> [f32; 3] {
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
fn an_attraction_is_the_gradient_of_the_mean_distance() {
    for (domain, shape) in shapes() {
        let attraction = domain.attraction().unwrap();
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
            let mut found = match shape.dims() {
                2 => {
                    let [a, b] = attraction.gradient([x[0], x[1]]);
                    [a, b, 0.0]
                }
                _ => attraction.gradient(x),
            };
            let mut expected = expected.map(|x| x as f32);
            // On a surface only what leads along it is asked for.
            if shape.surface().is_curved() {
                found = along(shape, x, found);
                expected = along(shape, x, expected);
            }
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 4e-3, "{domain} {place:?}: {found} {expected}");
            }
        }
    }
}

#[test]
fn a_distribution_on_a_grid_has_the_integrals_of_its_inverse() {
    for domain in Domain::ALL.into_iter().filter(|domain| !domain.is_square()) {
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
                let range = rank as f64 / 8.0 - 1e-3..(rank + 1) as f64 / 8.0 + 1e-3;
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
        for domain in Domain::ALL {
            let dims = domain.dims().unwrap_or(3);
            let mut point = x[..dims].to_vec();
            domain.surface().bring_all_back(&mut point, dims);
            prop_assert!(point.iter().all(|x| (0.0..1.0).contains(x)), "{}: {:?}", domain, point);
            let tile = with_dims(TileShape::new(1, 1, 1, 1, 1).unwrap(), dims, point.clone());
            prop_assert_eq!(domain.adopt(&tile), Ok(tile));
            let length = point.iter().map(|x| (x - 0.5) * (x - 0.5)).sum::<f32>().sqrt();
            match domain.surface() {
                Surface::Cube => (),
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
