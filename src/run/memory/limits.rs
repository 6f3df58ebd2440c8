//! How much memory this process can still have: what the machine has to give, and what is left of
//! the limits of its control groups and of its address space.
//!
//! Linux keeps the groups as folders, in one of two versions of files. The files of a group, and
//! of each around it, say what all of its processes may have together and what they do have.
//! Source: the kernel's `cgroup-v1/memory.rst`, `cgroup-v2.rst` and `filesystems/proc.rst`.

use std::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};

use super::field;

/// What limits the memory of this process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Limit {
    /// The machine has no more.
    Machine,
    /// A control group of this process may have no more; its folder.
    ControlGroup(PathBuf),
    /// This process may address no more (`RLIMIT_AS`).
    AddressSpace,
}

impl fmt::Display for Limit {
    /// Says where memory is free, or not.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Machine => out.write_str("on this machine"),
            Self::ControlGroup(path) => {
                write!(out, "in the memory limit of control group {}", path.display())
            }
            Self::AddressSpace => out.write_str("under the limit of address space (ulimit -v)"),
        }
    }
}

/// The limit that leaves least, and how many bytes it leaves; nothing where the system does not
/// report any.
pub fn tightest() -> Option<(u64, Limit)> {
    #[cfg(unix)]
    let address_space = rustix::process::getrlimit(rustix::process::Resource::As).current;
    #[cfg(not(unix))]
    let address_space = None;
    tightest_in(Path::new("/"), address_space)
}

/// The tightest limit of a system whose files are under `root`, `address_space` among them.
fn tightest_in(root: &Path, address_space: Option<u64>) -> Option<(u64, Limit)> {
    let machine = field(&root.join("proc/meminfo"), "MemAvailable:");
    let machine = machine.map(|free| (free, Limit::Machine));
    let space = address_space.map(|limit| {
        let used = field(&root.join("proc/self/status"), "VmSize:").unwrap_or(0);
        (limit.saturating_sub(used), Limit::AddressSpace)
    });
    let groups = groups(root).into_iter().flatten();
    // Of equal ones, the first.
    machine.into_iter().chain(groups).chain(space).min_by_key(|(free, _)| *free)
}

/// What is free in each limited control group of this process.
fn groups(root: &Path) -> Option<Vec<(u64, Limit)>> {
    let own = text(&root.join("proc/self/cgroup"))?;
    let mounts = text(&root.join("proc/self/mountinfo"))?;
    let mut found = Vec::new();
    for mount in mounts.lines().filter_map(Mount::parse) {
        let Some(path) = own.lines().find_map(|line| mount.version.path(line)) else { continue };
        let top = root.join(mount.point.strip_prefix("/").unwrap_or(&mount.point));
        // In a container that path may be one outside: then the top of what is mounted is ours.
        let is_inside = |path: &&Path| {
            let is_name = |part| matches!(part, Component::Normal(_));
            path.components().all(is_name) && top.join(path).is_dir()
        };
        let below = Path::new(path).strip_prefix(&mount.root).ok().filter(is_inside);
        for group in below.unwrap_or(Path::new("")).ancestors() {
            if let Some(free) = mount.version.free(&top.join(group)) {
                // Not joined with nothing, which would add a slash.
                let parts = mount.point.components().chain(group.components());
                found.push((free, Limit::ControlGroup(parts.collect())));
            }
        }
    }
    Some(found)
}

/// A place where the control groups that limit memory can be seen.
struct Mount {
    version: &'static Version,
    /// The group that is seen there.
    root: PathBuf,
    point: PathBuf,
}

impl Mount {
    /// From a line of `mountinfo`; nothing if it is of something else.
    fn parse(line: &str) -> Option<Self> {
        // Any number of optional fields is between these.
        let (place, kind) = line.split_once(" - ")?;
        let mut place = place.split(' ').skip(3);
        let (root, point) = (place.next()?, place.next()?);
        let mut kind = kind.split(' ');
        let (kind, options) = (kind.next()?, kind.nth(1)?);
        let version = match kind {
            "cgroup2" => &V2,
            "cgroup" if options.split(',').any(|option| option == "memory") => &V1,
            _ => return None,
        };
        Some(Self { version, root: unescape(root), point: unescape(point) })
    }
}

/// The names of a version's files.
#[derive(Debug)]
struct Version {
    /// The controller in the list of a process's groups; version 2 names none.
    controller: &'static str,
    limit: &'static str,
    usage: &'static str,
    /// Files in memory, in `memory.stat`. The system drops them for whoever needs memory.
    cache: [&'static str; 2],
}

/// Version 1: a tree of groups for every controller.
const V1: Version = Version {
    controller: "memory",
    limit: "memory.limit_in_bytes",
    usage: "memory.usage_in_bytes",
    cache: ["total_inactive_file", "total_active_file"],
};

/// Version 2: one tree.
const V2: Version = Version {
    controller: "",
    limit: "memory.max",
    usage: "memory.current",
    cache: ["inactive_file", "active_file"],
};

impl Version {
    /// The path of a process's group, from a line of its list of groups if it is this version's.
    fn path<'a>(&self, line: &'a str) -> Option<&'a str> {
        let (_, line) = line.split_once(':')?;
        let (controllers, path) = line.split_once(':')?;
        controllers.split(',').any(|name| name == self.controller).then_some(path)
    }

    /// Bytes that the processes of a group can still have, if it has a limit.
    fn free(&self, group: &Path) -> Option<u64> {
        let number = |name| text(&group.join(name))?.trim().parse::<u64>().ok();
        let (limit, usage) = (number(self.limit)?, number(self.usage)?);
        let stat = text(&group.join("memory.stat")).unwrap_or_default();
        let cache = stat.lines().filter_map(|line| {
            let (name, bytes) = line.split_once(' ')?;
            self.cache.contains(&name).then(|| bytes.trim().parse::<u64>().ok()).flatten()
        });
        let cache = cache.fold(0_u64, u64::saturating_add);
        Some(limit.saturating_sub(usage.saturating_sub(cache)))
    }
}

/// A path as `mountinfo` has it.
fn unescape(text: &str) -> PathBuf {
    // The backslash last, as it begins the others.
    let escapes =
        [("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\043", "#"), ("\\134", "\\")];
    escapes.iter().fold(text.to_owned(), |text, (code, is)| text.replace(code, is)).into()
}

/// The text of a file; names in it may be in any encoding.
fn text(path: &Path) -> Option<String> {
    Some(String::from_utf8_lossy(&fs::read(path).ok()?).into_owned())
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;

    const MB: u64 = 1 << 20;

    /// The files of a machine with 900 MB free, and of a process that uses 100 MB.
    struct System(TempDir);

    impl System {
        /// `own` and `mounts` are the lists of the process.
        fn new(own: &str, mounts: &str) -> Self {
            let system = Self(TempDir::new().unwrap());
            system.put("proc/meminfo", "MemTotal: 4194304 kB\nMemAvailable: 921600 kB\n");
            system.put("proc/self/status", "Name:\tx\nVmSize:\t  102400 kB\nVmHWM:\t 1 kB\n");
            system.put("proc/self/cgroup", own);
            system.put("proc/self/mountinfo", mounts);
            system
        }

        fn put(&self, path: &str, text: &str) {
            let path = self.0.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }

        /// A group with a limit, of which so much is used and so much of that is cache. In MB.
        fn group(&self, version: &Version, path: &str, [limit, usage, cache]: [u64; 3]) {
            self.put(&format!("{path}/{}", version.limit), &format!("{}\n", limit * MB));
            self.put(&format!("{path}/{}", version.usage), &format!("{}\n", usage * MB));
            let halves = version.cache.map(|name| format!("{name} {}\n", cache * MB / 2));
            // Version 1 also has what the group's own processes use, without those of groups in it.
            let own = if version.controller.is_empty() { "" } else { "inactive_file 987654321\n" };
            let stat = format!("cache 7\n{own}inactive_file_not 9\n{}anon 5\n", halves.concat());
            self.put(&format!("{path}/memory.stat"), &stat);
        }

        /// MB that are free, and where.
        fn free(&self, address_space: Option<u64>) -> (u64, Limit) {
            let (free, limit) = tightest_in(self.0.path(), address_space).unwrap();
            (free / MB, limit)
        }
    }

    fn group(path: &str) -> Limit {
        Limit::ControlGroup(path.into())
    }

    const UNIFIED: &str = "30 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw\n";
    const SPLIT: &str = "31 23 0:28 / /sys/fs/cgroup rw shared:1 - tmpfs tmpfs rw,mode=755
34 31 0:31 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu
35 31 0:32 / /sys/fs/cgroup/memory rw,relatime shared:9 master:2 - cgroup cgroup rw,memory
";

    #[test]
    fn without_limits_the_machine_is_the_limit() {
        for (own, mounts) in [("", ""), ("0::/\n", UNIFIED), ("4:memory:/\n", SPLIT)] {
            assert_eq!(System::new(own, mounts).free(None), (900, Limit::Machine));
        }
        let system = System::new("0::/a/b\n4:memory:/a\n", &[UNIFIED, SPLIT].concat());
        // What is not limited is written so.
        system.put("sys/fs/cgroup/a/b/memory.max", "max\n");
        system.put("sys/fs/cgroup/a/b/memory.current", "5000000000\n");
        let endless = "9223372036854771712\n";
        system.put("sys/fs/cgroup/memory/a/memory.limit_in_bytes", endless);
        system.put("sys/fs/cgroup/memory/a/memory.usage_in_bytes", "5000000000\n");
        assert_eq!(system.free(None), (900, Limit::Machine));
        assert_eq!(tightest_in(Path::new("/nowhere"), None), None);
    }

    #[test]
    fn the_tightest_group_around_the_process_counts() {
        let system = System::new("1:name=systemd:/x\n0::/jobs/7/step\n", UNIFIED);
        let at = |path: &str| format!("sys/fs/cgroup/{path}");
        system.group(&V2, &at("jobs"), [800, 100, 0]);
        system.group(&V2, &at("jobs/7/step"), [600, 100, 0]);
        // Others' do not count.
        system.group(&V2, &at("jobs/8"), [1, 0, 0]);
        system.group(&V2, &at("x"), [1, 0, 0]);
        assert_eq!(system.free(None), (500, group("/sys/fs/cgroup/jobs/7/step")));
        // Files in memory make way.
        system.group(&V2, &at("jobs/7"), [300, 280, 60]);
        assert_eq!(system.free(None), (80, group("/sys/fs/cgroup/jobs/7")));
        system.group(&V2, &at("jobs"), [300, 400, 20]);
        assert_eq!(system.free(None), (0, group("/sys/fs/cgroup/jobs")));
        // A cache that is counted before the usage.
        system.group(&V2, &at("jobs"), [10, 5, 20]);
        assert_eq!(system.free(None), (10, group("/sys/fs/cgroup/jobs")));
    }

    #[test]
    fn the_older_version_has_a_tree_for_memory() {
        let own = "9:cpu,cpuacct:/cpu\n4:hugetlb,memory:/jobs/7\n3:memory_x:/other\n0::/7\n";
        let system = System::new(own, SPLIT);
        let at = |path: &str| format!("sys/fs/cgroup/{path}");
        system.group(&V1, &at("memory/jobs/7"), [300, 50, 30]);
        for other in ["cpu/cpu", "cpu/jobs/7", "memory/cpu", "memory/other", "memory/7"] {
            system.group(&V1, &at(other), [1, 0, 0]);
        }
        assert_eq!(system.free(None), (280, group("/sys/fs/cgroup/memory/jobs/7")));
        system.group(&V1, &at("memory"), [200, 0, 0]);
        assert_eq!(system.free(None), (200, group("/sys/fs/cgroup/memory")));
    }

    #[test]
    fn a_container_sees_its_group_as_the_top() {
        // The mount is of the group itself, or of one around it.
        let mounts = "5 3 0:9 /docker/ab /sys/fs/cgroup rw - cgroup2 cgroup rw,nsdelegate\n";
        for (own, place) in [
            ("0::/docker/ab\n", ""),
            ("0::/docker/ab/in\n", "/in"),
            ("0::/docker/abc\n", ""),
            ("0::/\n", ""),
            ("0::/../cd\n", ""),
            ("0::/docker/ab/../../../x\n", ""),
        ] {
            let system = System::new(own, mounts);
            let path = format!("/sys/fs/cgroup{place}");
            system.group(&V2, &path[1..], [300, 100, 0]);
            system.group(&V2, "x", [1, 0, 0]);
            assert_eq!(system.free(None), (200, group(&path)), "{own}");
        }
        // The path is one outside.
        let system = System::new("4:memory:/host/pod/7\n", SPLIT);
        system.group(&V1, "sys/fs/cgroup/memory", [300, 100, 0]);
        system.group(&V1, "sys/fs/cgroup/memory/host", [1, 0, 0]);
        assert_eq!(system.free(None), (200, group("/sys/fs/cgroup/memory")));
    }

    #[test]
    fn address_space_is_a_limit() {
        let system = System::new("", "");
        assert_eq!(system.free(Some(500 * MB)), (400, Limit::AddressSpace));
        assert_eq!(system.free(Some(50 * MB)), (0, Limit::AddressSpace));
        assert_eq!(system.free(Some(u64::MAX)), (900, Limit::Machine));
    }

    #[test]
    fn odd_texts_are_passed_over() {
        let mounts = "7 3 0:1 / /a\\040b\\134040 rw - cgroup2 x rw\n5 - \n - cgroup2 \nx\n\n- -";
        let system = System::new("0::/jobs:7\n0\n::\n:\n", mounts);
        system.group(&V2, "a b\\040/jobs:7", [300, 100, 0]);
        for (name, text) in [("memory.max", "-5"), ("memory.stat", "cache\n\ninactive_file x")] {
            system.put(&format!("a b\\040/{name}"), text);
        }
        let path = system.0.path().join("proc/self/mountinfo");
        let mut bytes = b"8 3 0:1 / /\xff rw - tmpfs x rw\n".to_vec();
        bytes.extend(fs::read(&path).unwrap());
        fs::write(path, bytes).unwrap();
        assert_eq!(system.free(None), (200, group("/a b\\040/jobs:7")));
    }

    #[test]
    fn messages_name_the_limit() {
        for (limit, part) in [
            (Limit::Machine, "on this machine"),
            (group("/sys/x"), "in the memory limit of control group /sys/x"),
            (Limit::AddressSpace, "under the limit of address space (ulimit -v)"),
        ] {
            assert_eq!(limit.to_string(), part);
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_system_tells() {
        assert!(tightest().is_some());
    }
}
