"""All limits of sizes and counts. Users may raise some of them by command-line flags; programs and scenes cannot raise any."""

from __future__ import annotations

from typing import Final

KIB: Final = 1024
MIB: Final = 1024 * KIB
GIB: Final = 1024 * MIB

# text of one program
MAX_PROGRAM_BYTES: Final = 256 * KIB
MAX_PROJECT_BYTES: Final = 4 * MIB
MAX_USED_FILES: Final = 64
MAX_USE_DEPTH: Final = 16
MAX_LINE_CHARACTERS: Final = 2000
MAX_NAME_CHARACTERS: Final = 64
MAX_NUMBER_DIGITS: Final = 32
MAX_NUMBER: Final = 3.0e38  # largest number that can be stored; a little further a float32 is infinite
MAX_BRACKET_DEPTH: Final = 64  # brackets of any kind, open at once
MAX_EXPRESSION_DEPTH: Final = 200  # operations inside operations, `1 + 1 + 1` being two deep; keeps recursion over a tree safe
MAX_FILE_STATEMENTS: Final = 4000  # of one file, those in braces too; counted before any of them is parsed
MAX_FILE_SPECIES: Final = 256  # of one file
MAX_FILE_TOKENS: Final = 30_000  # of one file: words, numbers and signs
MAX_SHOWN_DIAGNOSTICS: Final = 50

# meaning of one program
MAX_TREE_NODES: Final = 20_000  # of the tree, behaviours put in place of their calls
MAX_MACHINE_STATES: Final = 256
MAX_STEERING_LAYERS: Final = 32
MAX_FUZZY_RULES: Final = 64  # of one `fuzzy`
MAX_ATTRIBUTES: Final = 256
MAX_FIELDS: Final = 64
MAX_MEASURES: Final = 256
MAX_PAIR_VALUES: Final = 16  # others about which one agent stores a value per pair
MAX_TOUCHED_AGENTS: Final = 8  # others of a species that one agent can know to touch

# scene
MAX_SCENE_BYTES: Final = 1 * MIB
MAX_EDITS_BYTES: Final = 1 * MIB  # of the text of a cache's edits
MAX_EDITS: Final = 1000  # of one cache
MAX_YAML_DEPTH: Final = 32
MAX_YAML_NODES: Final = 50_000
MAX_MESH_BYTES: Final = 512 * MIB
MAX_MESH_FACES: Final = 10_000_000
MAX_MOTION_BYTES: Final = 4 * GIB  # of all frames of one thing of the world that moves
MAX_VOXELS: Final = 512_000_000
MAX_GRID_BYTES: Final = 8 * GIB
MAX_AGENTS: Final = 5_000_000
MAX_BIRTH_GENERATIONS: Final = 16  # generations within one step, where those born bear at once
MAX_FRAMES: Final = 1_000_000
MAX_FPS: Final = 960  # frames of a second of a scene, at most
MAX_SCENE_LENGTH: Final = 1e10  # millimetres (or units of the scene) of a length or a coordinate; squares of it fit float32
MAX_SCENE_ANGLE: Final = 1e6  # radians; a larger angle has too few digits left within its turn
MAX_SCENE_SECONDS: Final = 1e9  # seconds
MAX_SCENE_SPEED: Final = 1e10  # millimetres a second
MAX_SCENE_NUMBER: Final = 1e30  # of a value of a param or an attribute, in base units
MIN_POSITIVE_NUMBER: Final = 1e-9  # of a length, time or speed that has to be above zero, in the same units

# bodies
MAX_BODY_JSON_BYTES: Final = 64 * MIB  # of one JSON file
MAX_BODY_JSON_VALUES: Final = 1_000_000  # of one JSON file; numbers in a row count less
MAX_BODY_FILE_BYTES: Final = 512 * MIB  # of one glTF file, its buffers included
MAX_RIG_JOINTS: Final = 4096  # of one rig
MAX_RIG_CHANNELS: Final = 4096  # of one rig
MAX_SPECIES_BODIES: Final = 64  # of one species, in one line of a scene's crowd
MIN_BODY_WEIGHT: Final = 1e-6  # of one of several bodies
MAX_BODY_WEIGHT: Final = 1e6
MAX_NOTE_POINTS: Final = 10_000  # points of a path in a note
MAX_NOTES: Final = 1_000  # notes of a scene
MAX_WORN_LAYERS: Final = 64  # layers that agents of one species may show beside their own: bits of a mask
MAX_TEXTURE_PIXELS: Final = 32 * 1024 * 1024  # of all textures of one body
MAX_BODY_LEGS: Final = 64  # of one body
MAX_BODY_GAITS: Final = 32  # of one body
MIN_STRIDE: Final = 1e-6  # units of length of a definition
DUTY_FACTOR_RANGE: Final = (0.05, 0.95)  # the least and greatest share of a cycle that a foot stands
MAX_BODY_PARTS: Final = 4096  # shapes, layers, clips or transform groups of one definition
MAX_BODY_POINTS: Final = 3_000_000  # of all shapes of one definition
MAX_CLIP_BYTES: Final = 1 * GIB  # of all samples of the clips of one definition
MAX_CLIP_SAMPLES: Final = 1_000_000  # of one clip
MAX_JOINTS_PER_POINT: Final = 64  # joints that one point follows

# a command
COMMAND_MEMORY_BYTES: Final = 256 * MIB  # of address space, which libraries take before any work

# foreign files: what the process that reads them may take
MAX_READER_HEADER_BYTES: Final = 16 * MIB  # of the JSON of one message
MAX_READER_ARRAY_BYTES: Final = 6 * GIB  # of the arrays of one message
READER_BASE_MEMORY_BYTES: Final = 1536 * MIB  # of address space, of which libraries take a half
READER_MEMORY_PER_FILE_BYTE: Final = 12  # more for each byte of the files of a request
MAX_READER_MEMORY_BYTES: Final = 8 * GIB
READER_BYTES_PER_CPU_SECOND: Final = 256 * KIB  # of files that are given one second of CPU more each
READER_BASE_CPU_SECONDS: Final = 5  # of CPU for one request about files of no size
# Of CPU for all requests of one scene, in addition to those for the size of its files
READER_CPU_SECONDS_PER_SCENE: Final = 1_800
READER_BASE_WALL_SECONDS: Final = 60  # in addition to four times the seconds of CPU
MAX_USD_LAYERS: Final = 10_000  # files that one USD file is made of
MAX_USD_PRIM_DEPTH: Final = 256  # of prims below each other
MAX_USD_PRIMS: Final = 1_000_000  # of one composed stage
MAX_USD_INSTANCES: Final = 250_000  # places of one mesh by point instancers, nested ones multiplied
MAX_PACKAGE_FILES: Final = 10_000  # files in one .usdz

# senses and fields
MAX_QUERY_NEIGHBOURS: Final = 256  # of one agent in one question, the nearest
MAX_CANDIDATES_IN_RADIUS: Final = 8192  # others within the radius of one agent in one query, from which the nearest are chosen
MAX_SUBSTEPS: Final = 64  # of one step of a scene
MAX_FIELD_CELLS: Final = 20_000_000  # of one field
MAX_FIELD_STARTS: Final = 1_000  # starting values of one field in a scene
MAX_FIELD_START: Final = 1e9  # of one cell
MAX_FLOW_POINTS: Final = 4_000_000  # points in which one flow is computed

# preview
MAX_PREVIEW_CLIENTS: Final = 16
MAX_UNADMITTED_CONNECTIONS: Final = 64  # connections that are not yet admitted
MAX_PREVIEW_MESSAGE_BYTES: Final = 64 * KIB  # of one message from a page
MAX_PREVIEW_LINES: Final = 200  # notes, and edits, that pages add to a run
MAX_PREVIEW_FRAGMENTS: Final = 64  # that one message may come in
MAX_PREVIEW_REQUESTS_PER_SECOND: Final = 120
MAX_PREVIEW_FRAMES_PER_SECOND: Final = 500  # of the protocol, pings among them
MAX_QUEUED_MESSAGE_CHARACTERS: Final = 32 * MIB  # characters of messages for one client that does not take them
MAX_QUEUED_PACKET_BYTES: Final = 1 * GIB  # the same of packets, which clients share
MAX_SWEEP_POINTS: Final = 20_000  # of one design of a sweep, each run with every seed

# tasks on other processes and machines
MAX_TASK_ANSWER_BYTES: Final = 16 * MIB  # of JSON, of one task
MAX_BUNDLE_BYTES: Final = 1 * GIB  # of all files that travel with the tasks
MAX_TASK_OUTPUT_BYTES: Final = 64 * GIB  # of the files that one task makes, where they are fetched
