//! The library's few lines against the command with flags that say the same: equal bytes.

use perceptile::format::sidecar::Sidecar;
use perceptile::{Optimizer, Preset, Scores, Tile, Viewing};

use crate::tool::Room;

/// Makes `library.npy`, and `command.npy` by the command; returns the library's scores.
fn both(room: &Room, optimizer: Optimizer, flags: &str) -> Scores {
    let run = optimizer.run().unwrap();
    run.tile().save(room.at("library.npy")).unwrap();
    let line = format!("optimize --preset quick {flags} --out command.npy --force");
    room.run(&line).succeeded();
    assert_eq!(room.read("library.npy"), room.read("command.npy"), "{flags}");
    assert_eq!(&Tile::load(room.at("command.npy")).unwrap(), run.tile(), "{flags}");
    run.scores().unwrap()
}

#[test]
fn the_same_options_give_the_bytes_of_the_command() {
    let room = Room::new();
    let quick = || Optimizer::new(Preset::Quick).size(16, 12, 8).steps(20);

    let kernel = "gaussian(2.1)*fovvideovdp(60)@7x7x8";
    let scores = both(
        &room,
        quick().kernel(kernel.parse().unwrap()).seed(7).polish(3).threads(2),
        &format!("--tile 16x12x8 --steps 20 --seed 7 --polish 3 --kernel {kernel}"),
    );
    let provenance = Sidecar::read(&room.at("command.json")).unwrap();
    let found = provenance.scores["classes"][1]["perceived"]["mean"].as_f64().unwrap();
    assert!((found / scores.classes[1].perceived.mean - 1.0).abs() < 1e-12);

    // The shape decides about the polish; the start is a tile.
    let start = Optimizer::new(Preset::Quick).size(12, 12, 4).spp(2).dims(3).steps(2);
    let start = start.kernel("gaussian(1)@3x3x1".parse().unwrap()).run().unwrap().into_tile();
    start.save(room.at("start.npy")).unwrap();
    let viewing = Viewing { fps: 24.0, taa: Some(0.5), sigma: 1.2 };
    let text = viewing.kernel(start.shape()).unwrap().to_string().replace(' ', "");
    both(
        &room,
        Optimizer::new(Preset::Quick)
            .size(12, 12, 4)
            .spp(2)
            .dims(3)
            .steps(10)
            .viewing(viewing)
            .start_from(start),
        &format!(
            "--tile 12x12x4 --spp 2 --dims 3 --steps 10 --start start.npy --integrands 0 --kernel {text}"
        ),
    );
}
