//! Tiles of other domains than the square: better than mapped ones, made and scored by the command,
//! and refused where something does not fit.

use perceptile::domain::Domain;
use perceptile::metric::{Class, Coordinates, ScoreOptions, Scores};
use perceptile::{Optimizer, Preset, Tile};

use crate::densities::{densities, rows_and_columns};
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
    let domains = Domain::ALL.into_iter().filter(|domain| !domain.is_square());
    for domain in domains.chain([densities()[0]]) {
        let dims = domain.dims().unwrap();
        let mapped = domain.map(&square[domain.parameters(dims) - 1]).unwrap();
        let [native, mapped] = [tile(domain, dims), mapped].map(|tile| scores(domain, &tile));
        let axis_edges = native.class(Class::AxisEdge, Coordinates::All);
        assert_eq!(axis_edges.is_some(), domain.has_axes());
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

/// The density of `levels` in a file of the room.
fn put(room: &Room, name: &str, size: [usize; 2], levels: &[f64]) {
    std::fs::write(room.at(name), rows_and_columns(size, levels)).unwrap();
}

#[test]
fn the_command_makes_and_scores_tiles_of_a_density() {
    let room = Room::new();
    // A disk that is denser to the right. Its border is not where bytes change.
    let size = [30, 23];
    let level = |i: usize| {
        let [x, y] = [i % 30, i / 30].map(|i| i as f64 + 0.5);
        if (x / 30.0 - 0.5).hypot(y / 23.0 - 0.5) < 0.47 { 1.0 + x } else { 0.0 }
    };
    let levels: Vec<f64> = (0..30 * 23).map(level).collect();
    put(&room, "disk.npy", size, &levels);
    let small = "--domain density(disk.npy) --tile 32x32x8 --kernel gaussian(1)@5x5x1 --steps 60 \
                 --polish 5 --warp 200 --integrands 4";
    room.run(&format!("optimize {small}")).succeeded();
    let sidecar = room.sidecar();
    assert!(sidecar.command.contains("--domain 'density(disk.npy)'"), "{}", sidecar.command);
    let tile = Tile::load(room.at("tile.npy")).unwrap();
    // None where it is empty, and blocks of pixels in proportion, four times closer than by chance.
    let mut counts = vec![0.0; 30 * 23];
    for point in tile.samples().chunks(2) {
        let [x, y] = [0, 1].map(|k| (f64::from(point[k]) * size[k] as f64) as usize);
        counts[y * 30 + x] += 1.0;
    }
    let sum: f64 = levels.iter().sum();
    let (mut square, mut chance) = (0.0, 0.0);
    for block in 0..36 {
        let inside = |i: &usize| i % 30 / 5 + i / 30 / 4 * 6 == block;
        let of = |values: &[f64]| (0..690).filter(inside).map(|i| values[i]).sum::<f64>();
        let expected = 8192.0 * of(&levels) / sum;
        square += (of(&counts) - expected) * (of(&counts) - expected);
        chance += expected;
    }
    let is_empty = |(count, level): (&f64, &f64)| *level > 0.0 || *count == 0.0;
    assert!(counts.iter().zip(&levels).all(is_empty));
    assert!(square < chance / 16.0, "{square} {chance}");

    // The sidecar says what was made: the file where it is named, or beside it.
    room.run("optimize --tile 32x32x8 --steps 20 --integrands 0 --out square.npy").succeeded();
    let evaluate = "evaluate tile.npy --map square.npy --baselines white --integrands 64 --json";
    let json = room.run(evaluate).succeeded().out;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["options"]["domain"]["density"]["name"], "disk.npy");
    for class in json["tiles"][2]["scores"]["classes"].as_array().unwrap() {
        let mean = class["perceived"]["mean"].as_f64().unwrap();
        assert!((mean - 1.0).abs() < 0.12, "{class}");
    }
    assert_eq!(json["tiles"][0]["scores"]["classes"].as_array().unwrap().len(), 5);
    room.run("report page tile.npy --integrands 4").succeeded();
    let page = String::from_utf8(room.read("page/index.html")).unwrap();
    assert!(page.contains("--domain 'density(disk.npy)'"), "{page}");

    // Scores need the file, and are not of another one.
    std::fs::rename(room.at("disk.npy"), room.at("moved.npy")).unwrap();
    let missing = "the density `disk.npy`, which is not there; say where it is with --domain";
    room.run("evaluate tile.npy").failed(2, &[missing]);
    room.run("evaluate tile.npy --domain density(moved.npy)").succeeded();
    put(&room, "disk.npy", [2, 1], &[1.0, 2.0]);
    room.run("evaluate tile.npy").failed(2, &["disk.npy is another one"]);
    std::fs::create_dir(room.at("there")).unwrap();
    for (from, to) in
        [("tile.npy", "tile.npy"), ("tile.json", "tile.json"), ("moved.npy", "disk.npy")]
    {
        std::fs::copy(room.at(from), room.at("there").join(to)).unwrap();
    }
    room.run("evaluate there/tile.npy").succeeded();
    room.run("evaluate tile.npy --domain density(disk.npy)").succeeded();
    put(&room, "disk.npy", [2, 1], &[1.0, 0.0]);
    let outside = "which is not a point of the domain `density(disk.npy)`";
    room.run("evaluate tile.npy --domain density(disk.npy)").failed(2, &[outside]);
}

#[test]
fn what_is_no_density_is_refused() {
    let room = Room::new();
    let optimize = "optimize --tile 16x16x4 --steps 2 --integrands 0 --domain";
    for (size, levels, why) in [
        ([2, 2], vec![0.0; 4], "holds only zeros, so no sample may be anywhere"),
        ([2, 1], vec![1.0, -0.25], "row 0, column 1 holds -0.25"),
        ([2, 1], vec![f64::NAN, 1.0], "row 0, column 0 holds NaN"),
        ([1, 1], vec![1.0], "it has 1x1 pixels, but must have 2 to 1048576"),
        ([1025, 1024], vec![1.0; 1025 * 1024], "it has 1025x1024 pixels"),
    ] {
        put(&room, "d.npy", size, &levels);
        room.run(&format!("{optimize} density(d.npy)"))
            .failed(1, &["the density `d.npy` is refused", why]);
    }
    room.run(&format!("{optimize} density(none.png)")).failed(1, &["`none.png` cannot be read"]);
    put(&room, "d.npy", [2, 1], &[1.0, 3.0]);
    let dims = "a sample of the domain `density(d.npy)` has 2 dimensions, not 3";
    room.run(&format!("{optimize} density(d.npy) --dims 3")).failed(2, &[dims]);
    let replaced = "the density would be replaced by d.npy, a file of the tile";
    room.run(&format!("{optimize} density(d.npy) --out d.npy --force")).failed(2, &[replaced]);
    assert_eq!(room.names(""), ["d.npy"]);
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
