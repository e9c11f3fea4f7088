"""Every cap in one place. A person may raise one by a flag of the command line; a program or a scene never can."""

from __future__ import annotations

from typing import Final

KIB: Final = 1024
MIB: Final = 1024 * KIB
GIB: Final = 1024 * MIB

# text of one program
ANT_FILE_BYTES: Final = 256 * KIB
PROJECT_BYTES: Final = 4 * MIB
USED_FILES: Final = 64
USE_DEPTH: Final = 16
LINE_CHARACTERS: Final = 2000
NAME_CHARACTERS: Final = 64
NUMBER_DIGITS: Final = 32
LARGEST: Final = 3.0e38  # largest number that can be stored; a little further a float32 is infinite
NESTING: Final = 64  # brackets of any kind, open at once
EXPRESSION_DEPTH: Final = 200  # operations inside operations, `1 + 1 + 1` being two deep; keeps recursion over a tree safe
STATEMENTS: Final = 4000  # of one file, those in braces too; counted before any of them is parsed
SPECIES: Final = 256  # of one file
TOKENS: Final = 30_000  # of one file: words, numbers and signs
DIAGNOSTICS_SHOWN: Final = 50

# meaning of one program
NODES: Final = 20_000  # of the tree, behaviours put in place of their calls
STATES: Final = 256
LAYERS: Final = 32
RULES: Final = 64  # of one `fuzzy`
ATTRIBUTES: Final = 256
FIELDS: Final = 64
STRONGEST: Final = 16  # others about which one agent stores a value per pair
TOUCHED: Final = 8  # others of a species that one agent can know to touch

# scene
SCENE_BYTES: Final = 1 * MIB
YAML_DEPTH: Final = 32
YAML_NODES: Final = 50_000
MESH_BYTES: Final = 512 * MIB
MESH_FACES: Final = 10_000_000
MOVES_BYTES: Final = 4 * GIB  # of all frames of one thing of the world that moves
VOXELS: Final = 512_000_000
GRID_BYTES: Final = 8 * GIB
AGENTS: Final = 5_000_000
BIRTHS_IN_A_ROW: Final = 16  # generations within one step, where those born bear at once
FRAMES: Final = 1_000_000
FPS: Final = 960  # frames of a second of a scene, at most
SCENE_LENGTH: Final = 1e10  # millimetres (or units of the scene) of a length or a coordinate; squares of it fit float32
SCENE_ANGLE: Final = 1e6  # radians; a larger angle has too few digits left within its turn
SCENE_TIME: Final = 1e9  # seconds
SCENE_SPEED: Final = 1e10  # millimetres a second
SCENE_NUMBER: Final = 1e30  # of a value of a param or an attribute, in base units
SCENE_LEAST: Final = 1e-9  # of a length, time or speed that has to be above zero, in the same units

# bodies
BODY_TEXT_BYTES: Final = 64 * MIB  # of one JSON file
BODY_VALUES: Final = 1_000_000  # of one JSON file; numbers in a row count less
BODY_BYTES: Final = 512 * MIB  # of one glTF file, its buffers included
JOINTS: Final = 4096  # of one rig
CHANNELS: Final = 4096  # of one rig
LAYERS_WORN: Final = 64  # layers that agents of one species may show beside their own: bits of a mask
LEGS: Final = 64  # of one body
GAITS: Final = 32  # of one body
LEAST_STRIDE: Final = 1e-6  # units of length of a definition
DUTY: Final = (0.05, 0.95)  # the least and greatest share of a cycle that a foot stands
BODY_PARTS: Final = 4096  # shapes, layers, clips or transform groups of one definition
BODY_POINTS: Final = 3_000_000  # of all shapes of one definition
CLIP_BYTES: Final = 1 * GIB  # of all samples of the clips of one definition
CLIP_SAMPLES: Final = 1_000_000  # of one clip
CAPTURED: Final = 64  # joints that one point follows

# a command
COMMAND_MEMORY: Final = 256 * MIB  # of address space, which libraries take before any work

# foreign files: what the process that reads them may take
READER_HEADER_BYTES: Final = 16 * MIB  # of the JSON of one message
READER_BYTES: Final = 6 * GIB  # of the arrays of one message
READER_MEMORY: Final = 1536 * MIB  # of address space, of which libraries take a half
READER_MEMORY_A_BYTE: Final = 12  # more for each byte of the files of a request
READER_MEMORY_MOST: Final = 8 * GIB
READER_BYTES_A_SECOND: Final = 256 * KIB  # of files that are given one second of CPU more each
READER_SECONDS: Final = 5  # of CPU for one request about files of no size
READER_SECONDS_A_SCENE: Final = 1_800  # of CPU for all requests of one scene, in addition to those for the size of its files
READER_WALL_SECONDS: Final = 60  # in addition to four times the seconds of CPU
USD_LAYERS: Final = 10_000  # files that one USD file is made of
USD_LEVELS: Final = 256  # of prims below each other
USD_PRIMS: Final = 1_000_000  # of one composed stage
USD_INSTANCES: Final = 250_000  # places of one mesh by point instancers, nested ones multiplied
PACKAGE_PARTS: Final = 10_000  # files in one .usdz

# senses and fields
NEIGHBOURS: Final = 256  # of one agent in one question, the nearest
WITHIN_RADIUS: Final = 8192  # others within the radius of one agent in one query, from which the nearest are chosen
FIELD_CELLS: Final = 20_000_000  # of one field
FLOW_POINTS: Final = 4_000_000  # points in which one flow is computed

# preview
PREVIEW_CLIENTS: Final = 16
PREVIEW_STRANGERS: Final = 64  # connections that are not yet admitted
PREVIEW_MESSAGE_BYTES: Final = 64 * KIB  # of one message from a page
PREVIEW_FRAGMENTS: Final = 64  # that one message may come in
PREVIEW_ASKS_A_SECOND: Final = 120
PREVIEW_FRAMES_A_SECOND: Final = 500  # of the protocol, pings among them
PREVIEW_WORDS_WAITING: Final = 32 * MIB  # characters of messages for one client that does not take them
PREVIEW_PACKETS_WAITING: Final = 1 * GIB  # the same of packets, which clients share
SWEEP_POINTS: Final = 20_000  # of one design of a sweep, each run with every seed

# tasks on other processes and machines
ANSWER_BYTES: Final = 16 * MIB  # of JSON, of one task
BUNDLE_BYTES: Final = 1 * GIB  # of all files that travel with the tasks
MADE_BYTES: Final = 64 * GIB  # of the files that one task makes, where they are fetched
