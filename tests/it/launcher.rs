//! What the command makes of a launcher that started it as one of several.

use std::process::Command;

use crate::tool::{PROGRAM, Room};

#[cfg(not(feature = "mpi"))]
#[test]
fn a_launcher_is_told_what_is_missing() {
    let room = Room::new();
    let start = |rank: &str, size: &str| {
        let mut command = Command::new(PROGRAM);
        command.env("OMPI_COMM_WORLD_RANK", rank).env("OMPI_COMM_WORLD_SIZE", size);
        let small = "--tile 16x16x2 --kernel gaussian(1)@3x3x1 --steps 2 --integrands 0";
        command.arg("optimize").args(small.split(' '));
        room.start_as(command).end()
    };
    start("0", "4").failed(2, &["Open MPI started 4 ranks", "built without MPI", "--features mpi"]);
    // One speaks for all; launchers end all ranks at the first failure, so the others have none. One
    // alone needs no MPI.
    let other = start("1", "4");
    assert_eq!((other.code(), other.error.as_str()), (Some(0), ""));
    start("0", "1").succeeded();
}

#[cfg(feature = "mpi")]
#[test]
fn another_launcher_is_noticed() {
    let room = Room::new();
    // What a launcher of another MPI leaves in the environment.
    let mut command = Command::new(PROGRAM);
    command.env("PMI_RANK", "0").env("PMI_SIZE", "4").args(["optimize", "--preset", "quick"]);
    let ended = room.start_as(command).end();
    assert_eq!(ended.code(), Some(2), "{ended:?}");
    assert!(ended.error.contains("started 4 processes, but MPI sees 1"), "{ended:?}");
}
