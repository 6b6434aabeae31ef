"""Draw the optics of each light law.

Run as ``python docs/figures/light_laws.py``: writes light-free-dwell.svg,
light-equal-dwell.svg, light-two-arm.svg, light-column.svg and light-detectors.svg beside this file.
"""

from pathlib import Path

INK, SOFT, BEAM, ON, OFF = "#1b1f24", "#59636e", "#f2c14e", "#d55e00", "#0072b2"
MASKS = ("110110111000", "001110011001", "010011100110", "111000010101")
"""Three rows of four mirrors of each frame, 1 for ON."""


def text(x, y, words, colour=INK, anchor="middle"):
    """Words at a place."""
    where = f'x="{x}" y="{y}" text-anchor="{anchor}"'
    return f'<text {where} fill="{colour}" font-size="15">{words}</text>'


def beam(*points):
    """Light within a polygon."""
    corners = " ".join(f"{x},{y}" for x, y in points)
    return f'<polygon points="{corners}" fill="{BEAM}" fill-opacity="0.45"/>'


def lens(x, y, half, turn=0):
    """A lens seen from the side."""
    return (
        f'<ellipse cx="{x}" cy="{y}" rx="6" ry="{half}" transform="rotate({turn} {x} {y})" '
        f'fill="#cfe3f5" stroke="{INK}"/>'
    )


def detector(x, y, turn, colour, label="", label_at=(0, 0)):
    """A detector whose flat side looks along the angle `turn`."""
    shape = (
        f'<path d="M0,-16 v32 h-8 a16,16 0 0 1 0,-32 z" transform="translate({x} {y}) '
        f'rotate({turn})" fill="{colour}" stroke="{INK}"/>'
    )
    return shape + text(x + label_at[0], y + label_at[1], label)


def scene(x=50, y=150):
    """The scene: a bright digit on dark ground."""
    return (
        f'<rect x="{x - 26}" y="{y - 32}" width="52" height="64" fill="#30363d" stroke="{INK}"/>'
        f'<path d="M{x - 12},{y - 18} h24 l-14,38" fill="none" stroke="#ffffff" stroke-width="6"/>'
        + text(x, y + 52, "scene")
    )


def mirrors(x, y, cells, side, colours=("#30363d", "#ffffff")):
    """A frame seen from the front: OFF and ON mirrors."""
    return "".join(
        f'<rect x="{x + side * (i % 4)}" y="{y + side * (i // 4)}" width="{side}" height="{side}" '
        f'fill="{colours[int(cell)]}" stroke="{SOFT}"/>'
        for i, cell in enumerate(cells)
    )


def camera(second):
    """Scene, lens, micromirror device, and a detector on one arm or on both."""
    parts = [
        scene(),
        beam((76, 130), (170, 108), (170, 192), (76, 170)),
        beam((170, 108), (400, 112), (400, 188), (170, 192)),
        beam((400, 112), (322, 56), (302, 96), (400, 188)),
        beam((322, 56), (238, 42), (238, 46), (302, 96)),
        lens(170, 150, 46),
        lens(312, 76, 26, 62),
        detector(236, 44, 15, ON, "detector, ON", (-32, -22)),
        f'<rect x="400" y="106" width="10" height="88" fill="{SOFT}" stroke="{INK}"/>',
        text(405, 98, "DMD"),
    ]
    if second:
        parts += [
            beam((400, 112), (302, 204), (322, 244), (400, 188)),
            beam((302, 204), (238, 254), (238, 258), (322, 244)),
            lens(312, 224, 26, -62),
            detector(236, 256, -15, OFF, "detector, OFF", (-32, 34)),
        ]
    else:
        parts += [
            beam((400, 112), (302, 204), (322, 244), (400, 188)),
            f'<rect x="282" y="212" width="34" height="40" fill="{INK}" '
            f'transform="rotate(-28 300 232)"/>',
            text(268, 268, "beam dump, OFF"),
        ]
    return "".join(parts)


def timeline(times, law):
    """Frames side by side, each as wide as its share of the exposure, and the law."""
    x, parts = 24, [text(24, 322, "one exposure:", anchor="start")]
    for cells, share in zip(MASKS, times, strict=True):
        wide = 392 * share
        parts.append(mirrors(x + wide / 2 - 24, 336, cells, 12))
        parts.append(
            f'<rect x="{x}" y="380" width="{wide - 2}" height="22" fill="{BEAM}" stroke="{INK}"/>'
        )
        x += wide
    parts.append(f'<path d="M24,416 h392 m-8,-5 l8,5 l-8,5" fill="none" stroke="{INK}"/>')
    parts.append(text(416, 436, "time", SOFT, "end"))
    parts += [text(24, 462 + 22 * i, line, anchor="start") for i, line in enumerate(law)]
    return "".join(parts)


def column():
    """One splitter for each readout, which all count at the same time."""
    parts = [scene(40, 130), beam((66, 110), (100, 94), (100, 166), (66, 150))]
    parts.append(beam((100, 94), (410, 94), (410, 166), (100, 166)))
    for i, x in enumerate((160, 256, 352)):
        parts.append(beam((x - 28, 134), (x + 28, 134), (x + 4, 240), (x - 4, 240)))
        parts.append(
            f'<path d="M{x - 36},94 L{x + 36},166" stroke="{INK}" stroke-width="3" '
            f'stroke-dasharray="9 3"/>'
        )
        parts.append(lens(x, 198, 28, 90))
        parts.append(detector(x, 242, -90, ON, f"count {i + 1}", (0, 46)))
        parts.append(mirrors(x - 28, 40, MASKS[i], 14, ("#ffffff", "#e8a33d")))
        parts.append(text(x, 30, f"mask {i + 1}"))
    law = ("each splitter takes its own share of every pixel;", "all detectors count all the time")
    parts += [
        lens(100, 130, 42),
        f'<rect x="410" y="100" width="12" height="60" fill="{INK}"/>',
        text(416, 184, "rest"),
        *(text(24, 326 + 22 * i, line, anchor="start") for i, line in enumerate(law)),
    ]
    return "".join(parts)


def tiles():
    """A device divided among four detectors."""
    parts = [
        scene(50, 90),
        beam((76, 70), (170, 48), (170, 132), (76, 110)),
        beam((170, 48), (400, 52), (400, 128), (170, 132)),
        lens(170, 90, 46),
        f'<rect x="400" y="46" width="10" height="88" fill="{SOFT}" stroke="{INK}"/>',
        text(405, 36, "DMD"),
    ]
    colours = ("#e69f00", "#56b4e9", "#009e73", "#cc79a7")
    for row in range(4):
        for col in range(4):
            tile = 2 * (row > 1) + (col > 1)
            lit = (row * 5 + col * 3) % 4 != 1
            fill = colours[tile] if lit else "#30363d"
            parts.append(
                f'<rect x="{60 + 28 * col}" y="{186 + 28 * row}" width="28" height="28" '
                f'fill="{fill}" stroke="{INK}"/>'
            )
    parts.append(f'<path d="M192,242 h56 m-8,-5 l8,5 l-8,5" fill="none" stroke="{INK}"/>')
    for tile, colour in enumerate(colours):
        x, y = 276 + 64 * (tile % 2), 192 + 56 * (tile // 2)
        parts.append(
            f'<rect x="{x}" y="{y}" width="52" height="44" fill="{colour}" stroke="{INK}"/>'
            + text(x + 26, y + 28, str(tile + 1))
        )
    parts += [text(116, 324, "one frame on the DMD"), text(334, 324, "four detectors")]
    return "".join(parts)


def write(name, about, body, height):
    """Write one drawing on a white ground, which suits light and dark pages."""
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 440 {height}" width="440" '
        f'height="{height}" role="img" font-family="system-ui, sans-serif"><title>{about}</title>'
        f'<rect width="440" height="{height}" rx="8" fill="#ffffff"/>{body}</svg>\n'
    )
    (Path(__file__).parent / f"light-{name}.svg").write_text(svg)


if __name__ == "__main__":
    own = (0.4, 0.15, 0.28, 0.17)
    write(
        "free-dwell",
        "One DMD and one detector; each frame is shown for its own time",
        camera(second=False)
        + timeline(
            own,
            ("each frame is shown for its own share of the time;", "all shares sum to at most 1"),
        ),
        500,
    )
    write(
        "equal-dwell",
        "One DMD and one detector; all frames are shown for equal times",
        camera(second=False)
        + timeline((0.25,) * 4, ("each of F frames is shown", "for 1/F of the time")),
        500,
    )
    write(
        "two-arm",
        "One DMD with a detector on each of its two arms",
        camera(second=True)
        + timeline(own, ("what the ON detector does not get,", "the OFF detector gets")),
        500,
    )
    write("column", "A splitter and a detector for each readout", column(), 364)
    write("detectors", "A DMD whose four parts are each seen by a detector", tiles(), 346)
