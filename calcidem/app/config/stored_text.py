"""The configuration of a stored campaign as a TOML file that 'calcidem run' takes."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from calcidem.app.config.reader import TAKEN_FROM_ELSEWHERE
from calcidem.app.config.reference import written
from calcidem.storage.records import CampaignRecord


def stored_text(record: CampaignRecord, disks: str) -> str:
    """Text of a configuration with the identity of a stored campaign.

    ``disks`` is a CSV file with the disks at rest: it stands for a file of disks that the campaign was made from, which
    no database has. With it the identity is another one.
    """
    physics, seeds = record.parameters, record.seeds
    plan = {
        "name": record.name,
        "seeds": len(seeds) if seeds == tuple(range(1, len(seeds) + 1)) else seeds,
        "contents": record.contents,
        "root_seed": physics["root_seed"],
    }
    packing = dict(physics["packing"])
    if packing.pop("file_sha256", None) is not None:
        packing["file"] = disks
    lines = [f"# Campaign {record.hash}, written from its database."]
    for section, values in {"campaign": plan, **physics, "packing": packing}.items():
        if isinstance(values, Mapping):
            lines += ["", f"[{section}]", *_lines_of_keys(section, values)]
    return "\n".join((*lines, ""))


def _lines_of_keys(section: str, values: Mapping[str, Any]) -> Iterator[str]:
    """Lines of a section; a table within it is written in one line."""
    for name, value in values.items():
        if value is None or f"{section}.{name}" in TAKEN_FROM_ELSEWHERE:
            continue
        if isinstance(value, Mapping):
            yield f"{name} = {{ {', '.join(_lines_of_keys(f'{section}.{name}', value))} }}"
        else:
            yield f"{name} = {json.dumps(value, ensure_ascii=False) if isinstance(value, str) else written(value)}"
