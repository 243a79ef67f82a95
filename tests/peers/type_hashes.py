#!/usr/bin/env python3
"""Prints a line "name hash" for every message, service and action under a msgs folder, and for their parts: the type hash (RIHS01)
that rosbags computes. The members that rosidl adds to services and actions are written out here.

usage: type_hashes.py MSGS_FOLDER            msg/ srv/ action/ of patchmill_msgs, standard/<package>/msg/ of the others
       type_hashes.py MSGS_FOLDER NAME FILE  only the message NAME (package/msg/Name) whose definition is in FILE
"""
import re
import sys
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PACKAGE = "patchmill_msgs"


def service(name: str) -> dict[str, str]:
    """The texts of what rosidl makes of a request and a response."""
    return {
        name: f"{name}_Request request_message\n{name}_Response response_message\n{name}_Event event_message\n",
        f"{name}_Event": f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response\n",
    }


def action(name: str) -> dict[str, str]:
    """The texts of what rosidl makes of goal, result and feedback."""
    uuid = "unique_identifier_msgs/UUID goal_id\n"
    return {
        name: f"{name}_Goal goal\n{name}_Result result\n{name}_Feedback feedback\n{name}_SendGoal send_goal_service\n"
              f"{name}_GetResult get_result_service\n{name}_FeedbackMessage feedback_message\n",
        f"{name}_SendGoal_Request": f"{uuid}{name}_Goal goal\n",
        f"{name}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
        f"{name}_GetResult_Request": uuid,
        f"{name}_GetResult_Response": f"int8 status\n{name}_Result result\n",
        f"{name}_FeedbackMessage": f"{uuid}{name}_Feedback feedback\n",
        **service(f"{name}_SendGoal"),
        **service(f"{name}_GetResult"),
    }


def renamed(part, names: dict[str, str]):
    """The same field definitions with other type names."""
    if isinstance(part, (list, tuple)):
        return type(part)(renamed(p, names) for p in part)
    return names.get(part, part) if isinstance(part, str) else part


def main() -> int:
    folder = Path(sys.argv[1])
    texts, shown = {}, []
    for path in [*folder.glob("standard/*/msg/*.msg"), *folder.glob("msg/*.msg")]:
        package = PACKAGE if path.parent.parent == folder else path.parent.parent.name
        texts[f"{package}/msg/{path.stem}"] = path.read_text()
    shown += texts
    # rosbags parses messages only: what is in srv and action passes as messages and gets its own name afterwards.
    names = {}
    for kind, parts, implicit in [("srv", ["Request", "Response"], service), ("action", ["Goal", "Result", "Feedback"], action)]:
        for path in folder.glob(f"{kind}/*.{kind}"):
            sections = path.read_text().split("\n---\n")
            assert len(sections) == len(parts), path
            written = {f"{path.stem}_{part}": text for part, text in zip(parts, sections)}
            for name, text in {**written, **implicit(path.stem)}.items():
                assert f"{PACKAGE}/msg/{name}" not in texts, name
                texts[f"{PACKAGE}/msg/{name}"] = text
                names[f"{PACKAGE}/msg/{name}"] = f"{PACKAGE}/{kind}/{name}"
            shown += [f"{PACKAGE}/{kind}/{name}" for name in [path.stem, *written]]
    if len(sys.argv) > 2:
        texts[sys.argv[2]], shown = Path(sys.argv[3]).read_text(), [sys.argv[2]]
    types = {}
    for name, text in texts.items():
        # rosidl makes uint8 of a .msg file's char (so says the description that a colcon build writes); rosbags keeps char.
        text = re.sub(r"^char\b", "uint8", text, flags=re.MULTILINE)
        types |= {names.get(k, k): renamed(v, names) for k, v in get_types_from_msg(text, name).items()}
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    for name in sorted(shown):
        print(name, store.hash_rihs01(name))
    return 0


if __name__ == "__main__":
    sys.exit(main())
