"""From results to tables, plots and pictures: `tables.md` for people, `renders.json` for the report."""

import json
import os
import platform
import shlex
import sys
from dataclasses import dataclass

import numpy as np

from experiments import FRAME, FRAMES, WHITE, word
from measure import interval
from scenes import SCENES
from tiles import NARROW, SIGMA, TILES

# Ours for a view, which the paper tailors to the filter.
OURS = {"plain": "perception", "taa": "perception-taa", "taa_equal": "perception-taa"}
OURS_SPP4 = {"plain": "spp4", "taa": "spp4-taa", "taa_equal": "spp4-taa"}
VIEWS = {"plain": "no TAA", "taa": "TAA", "taa_equal": "TAA, equally filtered reference"}


def label(key):
    """A method's name for people."""
    if key == WHITE:
        return "White noise"
    name, comma, rest = key.partition(", ")
    return (TILES[name][0] if name in TILES else name) + comma + rest


@dataclass
class Table:
    """Rows of texts; `strong` has the places (row, column) of those that stand out."""

    title: str
    caption: str
    columns: list
    rows: list
    strong: set

    def markdown(self):
        """The table as people read it in a text."""

        def cell(row, column, text):
            return f"**{text}**" if (row, column) in self.strong else text

        lines = [f"## {self.title}", "", self.caption, ""]
        lines.append("| " + " | ".join(self.columns) + " |")
        lines.append("|" + "---|" * len(self.columns))
        for i, row in enumerate(self.rows):
            lines.append("| " + " | ".join(cell(i, j, text) for j, text in enumerate(row)) + " |")
        return "\n".join(lines) + "\n"

    def data(self):
        """The table as the report reads it."""
        rows = [
            [
                {"text": text, "strong": True} if (i, j) in self.strong else text
                for j, text in enumerate(row)
            ]
            for i, row in enumerate(self.rows)
        ]
        return {"title": self.title, "caption": self.caption, "columns": self.columns, "rows": rows}


def ratio(values, base):
    """The ratio of two means over runs and half its 95 % interval, with the spread of both."""
    (mean, half), (base_mean, base_half) = interval(values), interval(base)
    return mean / base_mean, mean / base_mean * np.hypot(half / mean, base_half / base_mean)


def paired(values, base):
    """The ratio of two methods in pairs of runs, and its 95 % interval."""
    mean, half = interval(np.log(np.array(values) / np.array(base)))
    return np.exp(mean), np.exp(mean - half), np.exp(mean + half)


def ratio_table(title, caption, results, keys, measures, base=WHITE):
    """Rows are scenes and their mean; columns are methods for each measure; the lowest is strong."""
    columns = ["Scene"] + [
        label(key) + (f", {text}" if text else "")
        for measure, text in measures.items()
        for key in keys[measure]
    ]
    rows, strong = [], set()
    means = {}
    for scene, result in results.items():
        row, at = [SCENES[scene].title], 1
        for measure in measures:
            values = [ratio(result[key][measure], result[base][measure]) for key in keys[measure]]
            lowest = min(range(len(values)), key=lambda i: values[i][0])
            strong.add((len(rows), at + lowest))
            for key, (mean, half) in zip(keys[measure], values):
                row.append(f"{mean:.3f} ±{half:.3f}")
                means.setdefault((measure, key), []).append(mean)
            at += len(values)
        rows.append(row)
    row, at = ["Mean"], 1
    for measure in measures:
        values = [np.mean(means[measure, key]) for key in keys[measure]]
        strong.add((len(rows), at + int(np.argmin(values))))
        row += [f"{value:.3f}" for value in values]
        at += len(values)
    return Table(title, caption, columns, rows + [row], strong)


def raw_table(title, caption, results, keys, measures):
    """The errors themselves, means over runs."""
    columns = ["Scene"] + [
        f"{label(key)}, {text}" for measure, text in measures.items() for key in keys[measure]
    ]
    rows = [
        [SCENES[scene].title]
        + [f"{np.mean(result[key][measure]):.3g}" for measure in measures for key in keys[measure]]
        for scene, result in results.items()
    ]
    return Table(title, caption, columns, rows, set())


def pair_table(title, caption, results, ours, others, measures):
    """Ours against the best of the others, in pairs of runs: the ratio and its 95 % interval."""
    columns = ["Scene"] + [
        part + (f", {text}" if text else "")
        for text in measures.values()
        for part in ("best other", "ours ÷ it")
    ]
    rows, strong = [], set()
    for scene, result in results.items():
        row = [SCENES[scene].title]
        for measure in measures:
            best = min(others, key=lambda key: np.mean(result[key][measure]))
            mean, low, high = paired(result[ours[measure]][measure], result[best][measure])
            if high < 1:
                strong.add((len(rows), len(row) + 1))
            row += [label(best), f"{mean:.3f} ({low:.3f}–{high:.3f})"]
        rows.append(row)
    return Table(title, caption, columns, rows, strong)


def animation_tables(results, foreign):
    """Tables 2, 3 and S2 of the paper, and what belongs to them."""
    others = ["spatial", *foreign]
    paper = {
        view: [*others, OURS[view], small]
        for view, small in (("plain", "small"), ("taa", "small-taa"))
    }
    paper["taa_equal"] = paper["taa"]
    every = {f"{view}_all": keys for view, keys in paper.items()}
    where = f"frame {FRAME + 1}"
    views = {view: VIEWS[view] for view in ("taa", "plain")}
    yield ratio_table(
        "Perceived error relative to white noise",
        f"pRelMSE of {where}, as in the paper's Table 2; ± is the 95 % interval over shifts of the tiles. Salaün et al. 2022 stands for a tile of this program for their kernel.",
        results,
        paper,
        views,
    )
    yield ratio_table(
        "Perceived error relative to white noise, against equally filtered references",
        f"pRelMSE of {where}. What moves lags behind with TAA whatever the samples are; here the reference lags as well.",
        results,
        paper,
        {"taa_equal": "TAA"},
    )
    yield ratio_table(
        "Perceived error relative to white noise, all frames",
        f"Mean over frames {FRAME + 1} to {FRAMES}; TAA against equally filtered references.",
        results,
        every,
        {"taa_equal_all": "TAA", "plain_all": "no TAA"},
    )
    pairs = {"taa_equal_all": "TAA", "plain_all": "no TAA"}
    yield pair_table(
        "Ours against the best other method",
        f"In pairs of equal shifts, mean over frames {FRAME + 1} to {FRAMES}, with 95 % intervals; TAA against equally filtered references.",
        results,
        {f"{view}_all": key for view, key in OURS.items()},
        others,
        pairs,
    )
    yield raw_table(
        f"Perceived error, σ = {SIGMA}",
        f"pRelMSE of {where}, as in the upper half of the paper's Table S2.",
        results,
        {view: [WHITE, *others, OURS[view]] for view in VIEWS},
        VIEWS,
    )
    base = next(iter(foreign), WHITE)
    ablation = ["gaussian", "taa", "small-taa"]
    yield ratio_table(
        f"Ablation: perceived error with TAA relative to {label(base)}",
        f"As in the paper's Table 3: 64×64×16 tiles that differ in the kernel alone, a Gaussian in space and time, TAA without perception, and both; mean over frames {FRAME + 1} to {FRAMES}, against references that are filtered equally and that are not.",
        results,
        {"taa_equal_all": ablation, "taa_all": ablation},
        {"taa_equal_all": "", "taa_all": "reference without TAA"},
        base,
    )
    yield pair_table(
        "Ablation: the full kernel against the better of the others",
        "In pairs of equal shifts, with 95 % intervals.",
        results,
        {"taa_equal_all": "small-taa", "taa_all": "small-taa"},
        ["gaussian", "taa"],
        {"taa_equal_all": "", "taa_all": "reference without TAA"},
    )
    yield flip_table(results, paper)


def narrow_tables(results, foreign):
    """The lower half of the paper's Table S2."""
    others = ["spatial-narrow", *foreign]
    keys = {view: [*others, f"{key}-narrow"] for view, key in OURS.items()}
    yield raw_table(
        f"Perceived error, σ = {NARROW}",
        f"pRelMSE of frame {FRAME + 1} with the σ of Wolfe et al. 2022 in the kernels, as in the lower half of the paper's Table S2.",
        results,
        {view: [WHITE, *row] for view, row in keys.items()},
        VIEWS,
    )
    yield ratio_table(
        f"Perceived error relative to white noise, σ = {NARROW}, all frames",
        f"Mean over frames {FRAME + 1} to {FRAMES}, tiles made for that kernel; TAA against equally filtered references.",
        results,
        {f"{view}_all": row for view, row in keys.items()},
        {"taa_equal_all": "TAA", "plain_all": "no TAA"},
    )


def flip_table(results, keys):
    """A second opinion."""
    columns = ["Scene"] + [
        f"{label(key)}, {VIEWS[view]}" for view in ("taa", "plain") for key in [WHITE, *keys[view]]
    ]
    rows, strong = [], set()
    for scene, result in results.items():
        row = [SCENES[scene].title]
        for view in ("taa", "plain"):
            values = [result[key][f"flip_{view}"] for key in [WHITE, *keys[view]]]
            strong.add((len(rows), len(row) + int(np.argmin(values))))
            row += [f"{value:.4f}" for value in values]
        rows.append(row)
    return Table(
        "A second opinion: FLIP",
        f"Mean FLIP difference (Andersson et al. 2020) of frame {FRAME + 1}, filtered in time, one run; against equally filtered references.",
        columns,
        rows,
        strong,
    )


def accumulation_table(results, foreign):
    """What is left when a still picture accumulates over a whole period."""
    short = [*foreign, "small", "small-taa"]
    columns = ["Scene"] + [
        f"{label(key)}, {text}" for text in ("16 frames", "as perceived") for key in short
    ]
    columns += [f"{label(key)}, 30 frames" for key in ("perception", "perception-taa")]
    rows, strong, sums = [], set(), []
    for scene, result in results.items():
        values = []
        for keys, measure, count in (
            (short, "mean", 16),
            (short, "mean_seen", 16),
            (("perception", "perception-taa"), "mean", 30),
        ):
            at_end = {
                key: [run[count - 1] for run in result[key][measure]] for key in (WHITE, *keys)
            }
            values.append([ratio(at_end[key], at_end[WHITE]) for key in keys])
        row, at = [SCENES[scene].title], 1
        for group in values:
            strong.add((len(rows), at + int(np.argmin([mean for mean, _ in group]))))
            at += len(group)
            row += [f"{mean:.3f} ±{half:.3f}" for mean, half in group]
        sums.append([mean for group in values for mean, _ in group])
        rows.append(row)
    rows.append(["Mean"] + [f"{value:.3f}" for value in np.mean(sums, axis=0)])
    return Table(
        "A still picture that accumulates",
        "Relative mean squared error of the mean of a whole period, relative to as many frames of white noise; as perceived: filtered in space.",
        columns,
        rows,
        strong,
    )


def plots(results):
    """The paper's Figure 8, and the error of a still picture that accumulates."""
    for title, caption, measure, y in (
        (
            "The first frames",
            "behind perception × TAA, nothing moves (the paper's Figure 8)",
            "curve",
            "pRelMSE",
        ),
        ("Accumulation", "the mean of all frames so far, nothing moves", "mean", "relMSE"),
    ):
        for scene, result in results.items():
            series = []
            for key, entry in result.items():
                points = list(zip(*entry[measure]))
                series.append(curve(label(key), range(1, len(points) + 1), points))
            yield {
                "title": f"{title}: {SCENES[scene].title}",
                "caption": f"{SCENES[scene].title}, {caption}.",
                "x": "frame",
                "y": y,
                "log_y": True,
                "series": series,
            }


def curve(name, x, points):
    """A line of a plot: the means over the runs of each point, and their 95 % intervals."""
    spread = [interval(runs) for runs in points]
    line = {"name": name, "x": list(x), "y": [mean for mean, _ in spread]}
    if len(points[0]) > 1:
        line["low"] = [mean * np.exp(-half / mean) for mean, half in spread]
        line["high"] = [mean * np.exp(half / mean) for mean, half in spread]
    return line


def scene_data(setup, results, prefix, text, ours, others):
    """Pictures of the frame of each scene, filtered in time as the eye does."""
    for scene, result in results.items():
        pictures = []
        for view in ("plain", "taa"):
            keys = [WHITE, *(key for key in others if key in result), *dict.fromkeys(ours[view])]
            for key in keys:
                measure = "taa_equal" if view == "taa" else view
                pictures.append(
                    {
                        "name": label(key),
                        "view": VIEWS[view],
                        "file": f"pictures/{scene}{prefix}-{view}-{word(key)}.png",
                        "value": result[key][measure][0],
                        "ratio": result[key][measure][0] / result[WHITE][measure][0],
                    }
                )
        yield {
            "name": SCENES[scene].title + text,
            "caption": f"{SCENES[scene].about}; frame {FRAME + 1}, filtered in time as the eye does; figures with TAA are against the equally filtered reference.",
            "width": setup.size,
            "height": setup.size,
            "reference": f"pictures/{scene}{prefix}-plain-reference.png",
            "views": ["no TAA", "TAA"],
            "pictures": pictures,
            "crops": [
                {"x": x, "y": y, "size": side} for x, y, side in SCENES[scene].crops_at(setup.size)
            ],
        }


def figures(results):
    """Pictures that belong side by side."""
    for scene in results.get("still", {}):
        pictures = []
        for key in ("spatial", "perception-taa"):
            for t in (1, 20):
                name = f"{label(key)}, frame {t}"
                pictures.append({"name": name, "file": f"pictures/{scene}-still-{key}-{t}.png"})
                pictures.append(
                    {
                        "name": f"{name}: error spectrum",
                        "file": f"pictures/{scene}-still-{key}-{t}-spectrum.png",
                    }
                )
        yield {
            "title": f"The first frame and the twentieth: {SCENES[scene].title}",
            "caption": "Crops behind TAA and perception, and where the error of the crop is (the paper's Figure 4).",
            "pictures": pictures,
        }
    for scene, result in results.get("tiling", {}).items():
        yield {
            "title": "A tile that is too small",
            "caption": f"{SCENES[scene].title}: perceived relative error of a frame, eight times; 32×32×10 (left) repeats visibly, 128×128×30 (right) does not (the paper's S Fig. 1).",
            "pictures": [
                {
                    "name": f"{label(key)}: pRelMSE {result[key]:.2g}",
                    "file": f"pictures/{scene}-tiling-{key}.png",
                }
                for key in ("tiny", "perception")
            ],
        }


def write(setup, results):
    """Writes `tables.md` and `renders.json`."""
    foreign = list(setup.foreign)
    made, drawn, scenes = [], [], []
    if results.get("animation"):
        made += animation_tables(results["animation"], foreign)
        ours = {"plain": ["perception", "small"], "taa": ["taa", "perception-taa", "small-taa"]}
        scenes += scene_data(setup, results["animation"], "", "", ours, ["spatial", *foreign])
    if results.get("narrow"):
        made += narrow_tables(results["narrow"], foreign)
    if results.get("still"):
        made.append(accumulation_table(results["still"], foreign))
        drawn += plots(results["still"])
    if results.get("four_samples"):
        keys = {view: ["spatial-spp4", *foreign, key] for view, key in OURS_SPP4.items()}
        every = {f"{view}_all": value for view, value in keys.items()}
        made.append(
            ratio_table(
                "Four samples per pixel",
                f"Relative to four samples of white noise; mean over frames {FRAME + 1} to {FRAMES}, equally filtered references. Tiles of four samples are 64×64×16; those of one are read at four places.",
                results["four_samples"],
                every,
                {"taa_equal_all": "TAA", "plain_all": "no TAA"},
            )
        )
        ours = {view: [key] for view, key in OURS_SPP4.items()}
        scenes += scene_data(
            setup, results["four_samples"], "-spp4", ", 4 samples", ours, ["spatial-spp4", *foreign]
        )
    if results.get("path_traced"):
        first = next(iter(results["path_traced"].values()))
        keys = [key for key in first if key != WHITE]
        made.append(
            ratio_table(
                "Path tracing",
                "Three bounces, no TAA. Dimensions after a tile's last are white noise, or the tile is read again at another place for each further decision; the tile of eight is 64×64×16.",
                results["path_traced"],
                {"plain_all": keys},
                {"plain_all": ""},
            )
        )
        scenes += scene_data(
            setup, results["path_traced"], "", "", {"plain": keys, "taa": keys}, []
        )
    (setup.folder / "tables.md").write_text("\n".join(table.markdown() for table in made))
    write_renders(
        setup.folder,
        "Renders",
        scenes=scenes,
        tables=[table.data() for table in made],
        plots=drawn,
        figures=list(figures(results)),
    )


def write_renders(folder, title, **parts):
    """Writes `renders.json`: what a report shows of a folder."""
    data = {
        "format": 1,
        "title": title,
        "command": shlex.join(["python", *sys.argv]),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Mitsuba 3",
        **parts,
    }
    (folder / "renders.json").write_text(json.dumps(data, ensure_ascii=False, indent=1))
