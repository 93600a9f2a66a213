"""Files for other programs, as the commands and the library write them beside SVGs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from cli_runs import SHORT, save_pictures
from test_evaluate_untrusted import foreign
from test_export import RECTANGLE, skip_without_ezdxf, svg_of

import cubicsplat_cli as cubicsplat
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.paths import EXPORTS, is_ours


def test_imports_of_the_exports_never_run_back():
    source = Path(cubicsplat.__file__).parent
    importers, imported = set(), set()
    for path in source.rglob("*.py"):
        names = re.findall(r"from cubicsplat_cli\.(\w+)", path.read_text(encoding="utf-8"))
        folder = path.relative_to(source).parts[0]
        importers |= {folder} if "export" in names else set()
        imported |= set(names) if folder == "export" else set()
    assert importers == {"export", "pipeline", "jobs", "cli"}
    assert imported - {"artwork", "errors", "evaluate", "export", "files", "formatting", "scene", "svg"} == {
        "_version", "progress", "request", "settings",
    }  # fmt: skip


@pytest.mark.parametrize("form", EXPORTS)
def test_hostile_files_are_refused_or_harmless_in_every_format(form, tmp_path, run_cli):
    if form == "dxf":
        skip_without_ezdxf()
    uses = "".join('<g id="a{}">{}</g>'.format(i, 9 * f'<use href="#a{i - 1}"/>') for i in range(1, 9))
    refused = {
        "entity": foreign("", '<!DOCTYPE svg [<!ENTITY a "b">]>'),
        "outside": foreign('<use href="http://localhost/a.svg#a"/>'),
        "<image>": foreign('<image href="file:///etc/hostname"/>'),
        "by references": foreign(f'<rect id="a0" width="9" height="9"/>{uses}'),
        "no SVG": b"GIF89a",
    }
    for said, svg in refused.items():
        (tmp_path / "x.svg").write_bytes(svg)
        run_cli("render", tmp_path / "x.svg", "-o", tmp_path / f"x.{form}", code=1, error=said)
        assert not (tmp_path / f"x.{form}").exists()
    (tmp_path / "x.svg").write_bytes(svg_of(f"<script>alert(1)</script>{RECTANGLE}"))
    run_cli("render", tmp_path / "x.svg", "-o", tmp_path / f"x.{form}")
    assert b"alert" not in (tmp_path / f"x.{form}").read_bytes()


def test_render_by_suffix(tmp_path, run_cli):
    svg = tmp_path / "x.svg"
    svg.write_bytes(svg_of(RECTANGLE))
    run_cli("render", svg, "-o", tmp_path / "new" / "X.PDF")
    assert (tmp_path / "new" / "X.PDF").read_bytes().endswith(f", of {sha256_of(svg.read_bytes())}\n".encode())
    (tmp_path / "x.eps").write_bytes(b"%!PS mine")
    for arguments, code, said in (
        ([svg, "-o", tmp_path / "x.eps"], 2, "--force"),
        ([svg, "-o", tmp_path / "x.pfd"], 2, "did you mean .pdf?"),
        ([svg, "-o", tmp_path / "y.pdf", "--renderer", "resvg"], 2, "--renderer is of PNGs"),
        ([svg, "-o", tmp_path / "y.pdf", "--dxf-tolerance", 0], 2, "--dxf-tolerance must be a number from 0.001 to 10"),
        ([svg, svg.parent, "-o", tmp_path / "y.pdf"], 2, "give a folder"),
        ([tmp_path / "none.svg", "-o", tmp_path / "y.pdf"], 1, "no such file"),
    ):
        run_cli("render", *arguments, code=code, error=said)
    assert (tmp_path / "x.eps").read_bytes() == b"%!PS mine"
    run_cli("render", svg, "-o", tmp_path / "x.eps", "--force")
    assert is_ours(tmp_path / "x.eps")


def made_of(path: Path, svg: Path) -> bool:
    return f", of {sha256_of(svg.read_bytes())}".encode() in path.read_bytes()


def test_vectorize_by_suffix_and_also_and_what_a_later_run_makes(photo, tmp_path, run_cli):
    out = tmp_path / "out"
    fit = ("vectorize", photo, *SHORT)
    done = run_cli(*fit, "-o", out / "a.PDF", "--also", "xml,pdf")
    assert done.stderr.strip().endswith(b"  a.PDF  a.xml"), done.stderr
    assert {path.name for path in out.iterdir()} == {"a.svg", "a.png", "a.json", "a.PDF", "a.xml"}
    svg, drawable = out / "a.svg", out / "a.xml"
    assert made_of(out / "a.PDF", svg) and made_of(drawable, svg)
    before = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    drawable.write_bytes(drawable.read_bytes().replace(sha256_of(svg.read_bytes()).encode(), b"0" * 64))  # a stale one
    planned = run_cli(*fit, "-o", svg, "--also", "ps, .XML", "--also", "pdf", "--dry-run").stdout.decode()
    assert planned == f"to do  {photo} -> {drawable}, {out / 'a.ps'}, {out / 'a.pdf'}\n".replace(
        f"{drawable}, {out / 'a.ps'}", f"{out / 'a.ps'}, {drawable}"
    )
    done = run_cli(*fit, "-o", svg, "--also", "ps,xml")
    assert (b"unchanged" in done.stderr, b"a.ps: PS has no opacity" in done.stderr) == (True, True)
    assert made_of(out / "a.ps", svg) and made_of(drawable, svg)
    assert {path for path in before if path.stat().st_mtime_ns != before[path]} == {drawable}
    assert run_cli(*fit, "-o", svg, "--also", "ps,xml", "--dry-run").stdout.startswith(b"unchanged")
    run_cli(*fit, "-o", svg, "--also", "xml", "--seed", 3)
    assert made_of(drawable, svg) and not made_of(out / "a.ps", svg)


def test_a_dxf_of_another_tolerance_is_made_again_without_a_fit(photo, run_cli):
    skip_without_ezdxf()
    fit = ("vectorize", photo, *SHORT, "-o", photo.with_suffix(".dxf"))
    sizes = []
    for tolerance in (0.05, 0.5, 0.05):
        done = run_cli(*fit, "--dxf-tolerance", tolerance)
        assert (b"unchanged" in done.stderr) == bool(sizes), done.stderr
        # It holds the time, with any number of digits.
        sizes.append(photo.with_suffix(".dxf").read_bytes().count(b"\n"))
    assert sizes[0] == sizes[2] > sizes[1]


def test_exports_of_somebody_else_are_kept(photo, run_cli):
    fit = ("vectorize", photo, *SHORT, "--also", "pdf")
    foreign_pdf = photo.with_suffix(".pdf")
    foreign_pdf.write_bytes(b"%PDF-1.4 mine")
    run_cli(*fit, code=2, error="was not written by cubicsplat")
    assert not photo.with_suffix(".svg").exists(), "found out before the work"
    run_cli("vectorize", photo, *SHORT)
    for more in ([], ["--dry-run"]):  # although the SVG is finished
        run_cli(*fit, *more, code=2, error="was not written by cubicsplat")
    assert foreign_pdf.read_bytes() == b"%PDF-1.4 mine"
    run_cli(*fit, "--force")
    assert is_ours(foreign_pdf)


def test_a_page_of_somebody_else_is_kept_although_the_svg_is_finished(photo, run_cli):
    run_cli("vectorize", photo, *SHORT)
    photo.with_suffix(".html").write_text("<p>mine</p>")
    run_cli("vectorize", photo, *SHORT, "--report", code=2)
    assert photo.with_suffix(".html").read_text() == "<p>mine</p>"


def test_svg_only_still_writes_what_was_asked_for(photo, tmp_path, run_cli):
    run_cli("vectorize", photo, *SHORT, "-o", tmp_path / "o" / "a.eps", "--svg-only")
    assert {path.name for path in (tmp_path / "o").iterdir()} == {"a.svg", "a.eps"}


def test_folders_have_exports_beside_each_svg_and_svgz_counts_as_its_text(tmp_path, run_cli):
    save_pictures(tmp_path / "in", ("a.png", "b.png"))
    run = ("vectorize", tmp_path / "in", "-o", tmp_path / "out", "--svgz", "--also", "pdf", *SHORT)
    run_cli(*run)
    assert {path.name for path in (tmp_path / "out").glob("*.pdf")} == {"a.pdf", "b.pdf"}
    before = (tmp_path / "out" / "a.pdf").stat().st_mtime_ns
    (tmp_path / "out" / "b.pdf").unlink()
    assert run_cli(*run).stderr.count(b"unchanged") == 3
    assert (tmp_path / "out" / "b.pdf").exists() and (tmp_path / "out" / "a.pdf").stat().st_mtime_ns == before
    run_cli("vectorize", tmp_path / "in", "-o", tmp_path / "one.pdf", code=2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--also", "pdf,pfd"], "--also must name pdf, ps, eps, dxf or xml, not 'pfd'"),
        (
            ["-o", "x.pfd"],
            "the output must end in .svg, but -o is x.pfd; other formats are pdf, ps, eps, dxf, xml;",
        ),
        (["-o", "-", "--also", "pdf"], "--also needs a file"),
        (["-o", "x.pdf", "--suffix", "-a"], "--suffix"),
        (["--dxf-tolerance", "0"], "--dxf-tolerance must be a number from 0.001 to 10, not 0.0"),
    ],
)
def test_wrong_usage(arguments, said, photo, run_cli):
    run_cli("vectorize", photo, *arguments, code=2, error=said)


def test_a_format_that_cannot_be_written_costs_no_finished_fit(photo, run_cli, package):
    failing = "class units:\n    MM = 4\ndef new(*_, **__):\n    from cubicsplat_cli.errors import InputError\n"
    package("ezdxf", f"{failing}    raise InputError('no')\n")
    run_cli("vectorize", photo, *SHORT, "--also", "dxf", code=1, error="no")
    assert run_cli("vectorize", photo, *SHORT).stderr.count(b"unchanged") == 1


def test_a_missing_package_is_said_before_the_work(photo, run_cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    svg = photo.with_suffix(".svg")
    for command in (("vectorize", photo, "--also", "dxf"), ("vectorize", photo, "-o", photo.with_suffix(".dxf"))):
        run_cli(*command, code=1, error="cubicsplat: error: DXF needs ezdxf: pip install 'cubicsplat[dxf]'\n")
        assert not svg.exists()
    svg.write_bytes(svg_of(RECTANGLE))
    run_cli("render", svg, "-o", photo.with_suffix(".dxf"), code=1, error="pip install")


def test_save_by_suffix(photo, tmp_path):
    skip_without_ezdxf()
    result = cubicsplat.vectorize(photo, style="photo", curves=12, steps=30)
    for form in EXPORTS:
        result.save(tmp_path / f"r.{form}")
        assert sha256_of(result.svg.encode()).encode() in (tmp_path / f"r.{form}").read_bytes()
    with pytest.raises(UsageError, match=r"must end in \.svg.*did you mean \.dxf"):
        result.save(tmp_path / "r.dxxf")
    with pytest.raises(UsageError, match="dxf_tolerance must be"):
        result.save(tmp_path / "r.dxf", dxf_tolerance=0.0)
