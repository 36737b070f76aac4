"""One C file is generated from several: the needed functions, in order, and nothing else."""

from pathlib import Path

import pytest

from firmware_protocol.excerpt import excerpt, renamed

HEADER = """/* About the file. */
#ifndef X_H
#define X_H

#include <stdint.h>

enum { LAW_MOST = 3 }; /* what fits */
typedef enum { LAW_UP, LAW_DOWN = 2 } law_way;

/* A place; its member is called as a function is. */
typedef struct {
    int least; /* not the function; { is no brace here */
    law_way way;
} law_place;
typedef char law_wide[sizeof(int) == 4 ? 1 : -1];

int law_go(law_place *p, int by);
int law_stay(law_place *p);
#endif
"""
SOURCE = """#include "x.h"

static const int table[2] = {1, 2};

static int least(int a, int b)
{
    return a < b ? a : b;
}

int law_stay(law_place *p)
{
    return p->least;
}

/* Go. */
int law_go(law_place *p, int by)
{
    const char *brace = "}";
    p->least = least(p->least, by) + LAW_MOST + table[0];
    if (p->way == LAW_UP) {
#if defined(__ARM__)
        p->least = 0;
#endif
    }
    return brace[0];
}
"""


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    (tmp_path / "x.h").write_text(HEADER)
    (tmp_path / "x.c").write_text(SOURCE)
    return [tmp_path / "x.h", tmp_path / "x.c"]


def test_a_function_brings_what_it_needs_in_the_order_of_the_sources(sources: list[Path]) -> None:
    text = excerpt(sources, ["law_go"], "mine")
    order = [
        "enum { MINE_MOST = 3 };",
        "} mine_way;",
        "} mine_place;",
        "mine_table[2]",
        "mine_least(int a",
        "mine_go(",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert "stay" not in text
    assert "wide" not in text
    assert "About the file" not in text
    assert text.count("/* Go. */\nstatic int mine_go(mine_place *p, int by)\n{") == 1


def test_a_member_keeps_its_name_and_a_call_does_not(sources: list[Path]) -> None:
    assert "p->least = mine_least(p->least, by) + MINE_MOST + mine_table[0];" in excerpt(
        sources, ["law_go"], "mine"
    )


def test_comments_stay_where_they_were(sources: list[Path]) -> None:
    text = excerpt(sources, ["law_go"], "mine")
    assert "enum { MINE_MOST = 3 }; /* what fits */\n" in text
    assert "/* A place; its member is called as a function is. */\ntypedef struct {" in text
    assert "#if defined(__ARM__)\n" in text


def test_undefined_name_is_an_error(sources: list[Path]) -> None:
    with pytest.raises(KeyError):
        excerpt(sources, ["law_come"], "mine")


@pytest.mark.parametrize(
    ("name", "new"),
    [("law_kalman_run", "kalman_run"), ("law_kalman", "kalman"), ("law_biquad", "kalman_biquad"),
     ("LAW_MOST", "KALMAN_MOST"), ("least", "kalman_least")],
)  # fmt: skip
def test_a_name_gets_the_prefix_once(name: str, new: str) -> None:
    assert renamed(name, "kalman") == new
