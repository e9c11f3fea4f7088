import java.lang.management.ManagementFactory;
import java.util.Scanner;
import sim.app.antsforage.AntsForage;
import sim.app.flockers.Flocker;
import sim.app.flockers.Flockers;
import sim.engine.Schedule;
import sim.engine.SimState;
import sim.engine.Steppable;

/**
 * MASON's own flockers and foraging ants. `Mason boids AGENTS STEPS` begins anew for each turn, on a torus so wide that each sees
 * about nine others, nobody dead; `Mason foraging AGENTS STEPS` runs on, with all ants out at once: the example sends one a step.
 */
public class Mason {
    static final double NEIGHBOURS = 9;
    static final int WARM = 2;
    static final int WARM_ANTS = 100;

    /** Seconds of this thread: what compiles and collects garbage beside it is not counted. */
    static double processor() {
        return ManagementFactory.getThreadMXBean().getCurrentThreadCpuTime() * 1e-9;
    }

    static void steps(SimState state, int count) {
        for (int i = 0; i < count; i++) state.schedule.step(state);
    }

    static double timed(SimState state, int count) {
        double begun = processor();
        steps(state, count);
        return (processor() - begun) / count;
    }

    static Flockers flock(int agents) {
        Flockers flock = new Flockers(1);
        double side = flock.getNeighborhood() * Math.sqrt(agents * Math.PI / NEIGHBOURS);
        flock.setNumFlockers(agents);
        flock.setWidth(side);
        flock.setHeight(side);
        flock.setDeadFlockerProbability(0);
        flock.start();
        return flock;
    }

    static double neighbours(Flockers flock) {
        double seen = 0;
        Object[] all = flock.flockers.getAllObjects().toArray();
        for (Object each : all) seen += ((Flocker) each).getNeighbors().numObjs - 1;
        return seen / all.length;
    }

    static AntsForage ants(int agents) {
        AntsForage world = new AntsForage(1);
        world.setNumAnts(agents);
        world.start();
        world.schedule.clear();
        for (Object ant : world.buggrid.getAllObjects().toArray()) {
            world.schedule.scheduleRepeating(Schedule.EPOCH, 0, (Steppable) ant, 1);
        }
        Steppable fade = state -> {
            world.toFoodGrid.multiply(world.evaporationConstant);
            world.toHomeGrid.multiply(world.evaporationConstant);
        };
        world.schedule.scheduleRepeating(Schedule.EPOCH, 1, fade, 1);
        return world;
    }

    public static void main(String[] words) {
        int agents = Integer.parseInt(words[1]);
        int count = Integer.parseInt(words[2]);
        boolean boids = words[0].equals("boids");
        SimState state = boids ? null : ants(agents);
        if (!boids) steps(state, WARM_ANTS);
        Scanner lines = new Scanner(System.in);
        while (lines.hasNextLine()) {
            lines.nextLine();
            if (boids) {
                state = flock(agents);
                steps(state, WARM);
            }
            double step = timed(state, count);
            String seen = boids ? String.format("%.2f", neighbours((Flockers) state)) : "null";
            System.out.printf("{\"step\": %.9f, \"neighbours\": %s}%n", step, seen);
            System.out.flush();
        }
    }
}
