//! Tiles of other domains than the square: better than mapped ones, made and scored by the command,
//! and refused where something does not fit.

use perceptile::domain::Domain;
use perceptile::metric::{Class, Coordinates, ScoreOptions, Scores};
use perceptile::{Optimizer, Preset, Tile};

use crate::tool::Room;

/// A small tile of a domain.
fn tile(domain: Domain, dims: usize) -> Tile {
    let optimizer = Optimizer::new(Preset::Best).size(32, 32, 8).dims(dims).domain(domain);
    let run = optimizer.seed(5).steps(1200).polish(60).run().unwrap();
    run.tile().clone()
}

fn scores(domain: Domain, tile: &Tile) -> Scores {
    let kernel: perceptile::KernelSpec = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8".parse().unwrap();
    let kernel = kernel.resolve(tile.shape()).unwrap();
    let options = ScoreOptions { domain, set: 6, integrands: 128 };
    Scores::of(tile, &kernel.classes()[0].taps, options).unwrap()
}

/// Behind the same kernel and with the same effort, native tiles have less error than mapped ones, and
/// are as uniform. On the circle they need more steps for that than a test has.
#[test]
fn native_tiles_are_better_than_mapped_ones() {
    let square = [1, 2].map(|dims| tile(Domain::Square, dims));
    for domain in Domain::ALL.into_iter().filter(|domain| !domain.is_square()) {
        let dims = domain.dims().unwrap();
        let mapped = domain.map(&square[domain.parameters(dims) - 1]).unwrap();
        let [native, mapped] = [tile(domain, dims), mapped].map(|tile| scores(domain, &tile));
        assert!(native.class(Class::AxisEdge, Coordinates::All).is_none());
        let of =
            |scores: &Scores, class| scores.class(class, Coordinates::All).unwrap().perceived.mean;
        let quotient = |class| of(&native, class) / of(&mapped, class);
        let most = if domain == Domain::Circle { 1.15 } else { 0.97 };
        for class in [Class::Edge, Class::Bump, Class::Disk] {
            assert!(quotient(class) < most, "{domain}, {class}: {}", quotient(class));
        }
        assert!(native.bias < 0.5, "{domain}: bias {}", native.bias);
        let histogram = native.histogram;
        // 8,192 samples in 256 cells: of white noise it would be 0.177.
        assert!(histogram.rms < 0.06, "{domain}: {histogram:?}");
    }
}

#[test]
fn the_command_makes_and_scores_tiles_of_a_domain() {
    let room = Room::new();
    let small = "--tile 16x16x8 --kernel gaussian(1)@5x5x1 --steps 20 --warp 20 --integrands 4";
    room.run(&format!("optimize --domain cosine {small}")).succeeded();
    room.run(&format!("optimize {small} --out square.npy")).succeeded();
    let sidecar = room.sidecar();
    assert_eq!(sidecar.shape.dims(), 3);
    assert!(sidecar.command.contains("--domain cosine"), "{}", sidecar.command);

    // The sidecar says what was made.
    let table = room.run("evaluate tile.npy --map square.npy --baselines white").succeeded().out;
    assert!(table.contains("square-mapped") && !table.contains("axis edge"), "{table}");
    let json = room.run("evaluate tile.npy --baselines white --json --integrands 64").succeeded();
    let json: serde_json::Value = serde_json::from_str(&json.out).unwrap();
    assert_eq!(json["options"]["domain"], "cosine");
    let of_white = &json["tiles"][1]["scores"]["classes"];
    assert_eq!(of_white.as_array().unwrap().len(), 4);
    for class in of_white.as_array().unwrap() {
        let mean = class["perceived"]["mean"].as_f64().unwrap();
        assert!((mean - 1.0).abs() < 0.1, "{class}");
    }
    // A pixel's mean is compared with that of the domain, which is above ½ along the axis.
    let residual = json["tiles"][1]["scores"]["residual"].as_f64().unwrap();
    assert!((residual - 1.0).abs() < 0.15, "{residual}");
    // What 8 bits leave is made a unit vector again.
    let rounded = json["tiles"][0]["after_8_bits"]["classes"][1]["perceived"]["mean"].as_f64();
    let exact = json["tiles"][0]["scores"]["classes"][1]["perceived"]["mean"].as_f64();
    assert!((rounded.unwrap() / exact.unwrap() - 1.0).abs() < 0.1);
    room.run("report page tile.npy --map square.npy --integrands 4").succeeded();
    let page = String::from_utf8(room.read("page/index.html")).unwrap();
    assert!(page.contains("Samples of the cosine stand where an equal-area map"), "{page}");
    assert!(page.contains("--domain cosine --map square.npy"));
}

#[test]
fn what_does_not_fit_a_domain_is_refused() {
    let room = Room::new();
    let small = "--tile 16x16x8 --kernel gaussian(1)@5x5x1 --steps 2 --polish 0 --integrands 4";
    let sphere = "a sample of the domain `sphere` has 3 dimensions, not 2";
    room.run(&format!("optimize --domain sphere --dims 2 {small}")).failed(2, &[sphere]);
    let names = "there are: square, circle, disk, sphere, hemisphere, cosine";
    room.run(&format!("optimize --domain ball {small}")).failed(2, &["`ball` is no domain", names]);
    assert!(room.names("").is_empty());
    room.run(&format!("optimize {small}")).succeeded();
    room.run("evaluate tile.npy --domain sphere").failed(2, &["cannot score tile", sphere]);
    let disk = "which is not a point of the domain `disk`";
    room.run("evaluate tile.npy --domain disk").failed(2, &["cannot score tile", "sample ", disk]);
    let circle = "samples of 1 dimensions can be mapped to the domain `circle`, not of 2";
    room.run(&format!("optimize --domain circle {small} --out circle.npy")).succeeded();
    room.run("evaluate circle.npy --map tile.npy").failed(2, &["cannot map tile", circle]);
    let require = "--require says axis edge, but there is no such score of the domain `circle`";
    room.run("evaluate circle.npy --require axis-edge<=0.5").failed(2, &[require]);
    // A start has to be of the domain as well.
    let start = "--domain disk --start tile.npy --out other.npy";
    room.run(&format!("optimize {start} {small}")).failed(2, &[disk]);
    room.run(&format!("optimize --domain circle --start circle.npy --out again.npy {small}"))
        .succeeded();
}
