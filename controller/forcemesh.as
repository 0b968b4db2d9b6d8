.PROGRAM fm.main() ;robot program: EXECUTE fm.main. Command processor, see README.md
  ; forcemesh, the program inside the controller. Protocol 3.
  ; This is not a safety function. Load, start and stop: README.md beside this file.
  ; fm.main  robot program: takes 1-3, 5, 6, 7 (start), 10, 11, 13 from the ring; moves
  ; fm.send  PC program 1: sends 101, 102, 103, 104 without end
  ; fm.recv  PC program 2: the socket; checks packets; does 4, 8, 9, 12, 14, 15, 7 (stop) at once
  ; fm.watch PC program 3: watchdog; brakes, latches, watches the pendant and the other tasks
  ; No subroutine is called by two of them. Every variable has one task that writes it, named
  ; in fm.init; the exceptions are named there too. Loops carry their comments at line ends and
  ; behind RETURN, because a line with only a comment is a step.
  CALL fm.config
  CALL fm.begin
  IF fm.other<>0 GOTO other
  CALL fm.init
  TOOL NULL
  BASE NULL
  CP ON
  ABS.SPEED OFF ;the monitor speed scales every speed
  QTOOL OFF ;or the pendant would replace TOOL
  SPEED 10 MM/S ALWAYS ;of force feedback, until command 10
  ACCURACY fm.accur ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  JMOVE #HERE ;no way to go: the first motion of a program takes longest to plan
  BREAK
  PCEXECUTE 3: fm.watch
  PCEXECUTE 1: fm.send
  PCEXECUTE 2: fm.recv
  TIMER 6=0
turn:
  WAIT (fm.rh<>fm.rt) OR (fm.wn<>fm.wu) OR (fm.hseq+fm.wseq<>fm.ack) OR (TIMER(6)>0.5)
  fm.loops=(fm.loops+1) MOD 500000
  IF fm.hseq+fm.wseq<>fm.ack THEN ;a hold came
    CALL fm.halt
  END
  IF fm.rh<>fm.rt THEN
    CALL fm.take
  END
  IF fm.wn<>fm.wu THEN
    CALL fm.step
  END
  IF TIMER(6)<=0.5 GOTO turn
  CALL fm.tick
  IF fm.quit==0 GOTO turn
  CALL fm.leave
  RETURN
other: ;never aborted: it may guard something else
  PRINT "forcemesh needs PC programs 1, 2 and 3: another program is in",fm.other
.END
.PROGRAM fm.config() ;what may be changed for a cell
  fm.port=49152 ;TCP port that is listened on, 8192 to 65535
  fm.accur=10 ;ACCURACY of every motion [mm]: larger than the spacing of a stream
  fm.tsend=0.008 ;pause of the sender between two samples [s]
  fm.twatch=0.03 ;pause of the watchdog between two looks [s]
  fm.still=0.03 ;all joints together turn slower than this at rest [deg/s]
  fm.lever=1.75 ;one degree of a turn counts as this many mm of way (100 mm/rad)
  fm.num=1 ;number of this arm, 0 to 999, as gateway.arm in the cell file
  fm.peer[1]=0 ;address of the PC, four numbers: no other one may connect
  fm.peer[2]=0 ;all four 0: any may
  fm.peer[3]=0
  fm.peer[4]=0
.END
.PROGRAM fm.begin() ;stop what an earlier run left; keep TOOL, BASE and switches for fm.leave
  fm.other=0
  CALL fm.end.pc
  IF EXISTREAL("fm.sock")==0 THEN
    fm.sock=0
  END
  IF (EXISTREAL("fm.saved")==0) OR (EXISTREAL("fm.qtool0")==0) THEN
    fm.saved=0
  END
  IF EXISTREAL("fm.eres")==0 THEN
    fm.eres=0 ;errors of the connection that fm.watch has reset
    fm.eresu=0 ;the last of them that was reported
  END
  CALL fm.frames
  ; An aborted run leaves TOOL and BASE null and fm.saved set: then the ones it kept are right.
  IF (fm.saved==0) OR (fm.null==0) THEN
    POINT fm.tool0=TOOL
    POINT fm.base0=BASE
    fm.cp0=ABS(SWITCH(CP))
    fm.abs0=ABS(SWITCH(ABS.SPEED))
    fm.qtool0=ABS(SWITCH(QTOOL))
    fm.saved=1
  END
.END
.PROGRAM fm.end.pc() ;end our PC programs; fm.other: where another program is, or 0
  IF TASK(1001)<>0 THEN
    IF WHICHTASK("fm.send")==1001 THEN
      PCABORT 1:
    ELSE
      fm.other=1
    END
  END
  IF TASK(1002)<>0 THEN
    IF WHICHTASK("fm.recv")==1002 THEN
      PCABORT 2:
    ELSE
      fm.other=2
    END
  END
  IF TASK(1003)<>0 THEN
    IF WHICHTASK("fm.watch")==1003 THEN
      PCABORT 3:
    ELSE
      fm.other=3
    END
  END
  TIMER 6=0
  WAIT (fm.other<>0) OR ((TASK(1001)<>1) AND (TASK(1002)<>1) AND (TASK(1003)<>1)) OR (TIMER(6)>5)
.END
.PROGRAM fm.init() ;every global gets its value here, before the PC programs start
  ; written by fm.recv
  fm.link=0 ;1: connected and greeted, the sender may send
  fm.conn=0 ;number of the connection
  fm.hseq=0 ;holds by command 8, hello, or the end of a connection
  fm.stopn=0 ;commands 7 with Param 2
  fm.lack=0 ;the fm.lat that a hello has cleared
  fm.arm=0 ;1: something may move, so silence is a fault
  fm.framed=0 ;ID of the last valid packet
  fm.hid=0 ;ID of the last command 8 or hello, less 500000
  fm.rh=0 ;ring: next free slot
  fm.wn=0 ;wrenches received, modulo 1000000
  fm.wb=0 ;bank of the newest one
  fm.zn=0 ;set points of force received, modulo 1000000
  fm.zb=4 ;bank of the newest one; 4: none came, it is zero
  fm.sgc=-1 ;the fm.conn on which command 15 has chosen what 104 reports
  $fm.next="" ;ID and space of the packet that comes next; empty: hello does
  fm.sp=50 ;scales, set by hello: packet units per mm,
  fm.so=500 ;degree of O, A, T,
  fm.sj=250 ;degree of a joint,
  fm.sf=100 ;N,
  fm.sm=1000 ;N m,
  fm.sv=10 ;mm/s
  ; written by fm.watch
  fm.wseq=0 ;holds by the watchdog
  fm.lat=0 ;times that it latched
  fm.bdone=-1 ;all braking for holds up to this fm.hseq+fm.wseq is over
  fm.gap=0 ;times that wrenches stayed away for three of their intervals
  fm.dropw=-1 ;connection that shall be closed
  fm.hw=-1 ;status bits of the machine, not known yet
  ; written by fm.send
  fm.drops=-1 ;connection that shall be closed
  fm.sbeat=0 ;samples, modulo 240: the counter of 101 and 102
  fm.busy=0 ;1: inside TCP_SEND
  ; written by fm.main and its subroutines
  fm.quit=0 ;a person may set it to 1: fm.main ends and puts everything back
  fm.rt=0 ;ring: next slot to read
  fm.ack=-1 ;the fm.hseq+fm.wseq that was obeyed
  fm.rel=-1 ;the fm.hseq+fm.wseq after which something was let move: HELD ends
  fm.refd=0 ;not 0: the last target was refused; above 1: the fault that says why
  fm.set=0 ;banks of command 10 that came: 1, 2, 4, 8, 16, 32; 64: command 11
  fm.setc=-1 ;fm.conn of the connection on which they came
  fm.stream=-1 ;the fm.hseq+fm.wseq under which fm.p0 was the last motion
  fm.mode=0 ;force feedback: 1 ForceFeedBackPosition + 2 ForceFeedBackOrientation
  fm.ffe=-1 ;the fm.hseq+fm.wseq+fm.stopn under which it started
  fm.ask=0 ;times that fm.main asked the watchdog to hold
  fm.wu=0 ;the last fm.wn that was used
  fm.gapu=0 ;the last fm.gap that was noticed
  fm.first=0 ;1: the next wrench is the first one
  fm.loops=0 ;turns of the loop of fm.main
  fm.null=1 ;1: TOOL and BASE are null
  fm.t0=0 ;TIMER(10) at the last iteration
  fm.v=50 ;program speed of commands 1 to 3 and 13 [mm/s]
  fm.tnext=0 ;TIMER(5) at which the next segment may be given
  fm.short=0 ;1: the last segment was too short to blend: BREAK comes before the next
  fm.turned=0 ;turn of force feedback since the last segment [deg]
  $fm.oat="" ;O, A, T of the last command 1 or 13
  ; written by fm.recv at a hello and by fm.take: ID of the last command taken
  fm.taken=0
  ; written by whoever finds a fault, cleared by fm.take: see README.md
  fm.fault=0
  ; limits of command 10
  fm.lstep=1 ;[mm]
  fm.lturn=0.5 ;[deg]
  fm.lspeed=10 ;[mm/s]
  fm.ltravel=20 ;[mm]
  fm.lforce=50 ;[N]
  fm.wd=0.25 ;watchdog [s]
  fm.lcos=1 ;cosine of half the turn since the first motion after a hold
  fm.ltorque=1 ;[N m]
  fm.lset=0 ;from one set point to the next [mm]
  fm.scos=1 ;the same, cosine of half the turn
  fm.lfast=50 ;highest program speed [mm/s]
  fm.tmove=0.03 ;least time of a motion that blends into the next one [s]
  fm.vmin=1.2 ;slowest program speed that the controller keeps [mm/s]
  fm.any=ABS(fm.peer[1]+fm.peer[2]+fm.peer[3]+fm.peer[4]==0) ;1: any address may connect
  POINT fm.tcp=NULL ;command 11: the tool centre point, in the flange frame
  POINT fm.ctr=NULL ;command 11: the point to turn about, in the flange frame
  POINT fm.in=NULL ;the robot base, seen from the middle of the box
  POINT fm.a0=NULL ;where the flange was at the first motion after a hold
  POINT fm.p0=NULL ;the last set point that was let move
  POINT fm.s0=NULL ;the end of the last segment
  POINT fm.from=NULL ;where a turn is measured from
  POINT fm.r0=NULL ;orientation at the start
  POINT fm.q0=NULL ;from the point to the flange, with that orientation
  POINT fm.rot=NULL ;rotation since the start, base axes
  POINT fm.p=NULL ;target
  POINT #fm.j=#HERE ;target of a joint motion
  FOR .i=1 TO 6
    fm.kp[.i]=0 ;gains of command 6
    fm.ki[.i]=0
    fm.f[.i]=0 ;wrench of the iteration before
    fm.w[0,.i]=0 ;two banks for command 4, in packet units
    fm.w[1,.i]=0
    fm.w[2,.i]=0 ;two for command 14
    fm.w[3,.i]=0
    fm.w[4,.i]=0 ;stays zero
    fm.b[.i]=0 ;box of the TCP: lower corner, upper corner [mm]
    fm.h[.i]=0 ;1-3: half of its size
    fm.d[.i]=0 ;1-3: displacement since the start [mm]
    fm.c[.i]=0 ;1-3: the point to turn about at the start [mm]
    fm.jmax[.i]=100 ;speeds of the joints at 100 % [deg/s]
  END
  FOR .i=1 TO 4
    fm.ip[.i]=0 ;address of the peer
  END
  FOR .i=0 TO 63
    $fm.ring[.i]="" ;packets
    fm.ringe[.i]=-1 ;fm.hseq+fm.wseq when it came
    fm.rings[.i]=-1 ;fm.stopn when it came
  END
  FOR .i=1 TO 6
    fm.sg[.i]=0 ;where the groups of 16 signals begin that 104 reports, 0: none
    $fm.s[.i]="" ;fields of 104
  END
  FOR .i=1 TO 22
    $fm.t[.i]="" ;fields to send, 21 of them
    $fm.rx[.i]="" ;what TCP_RECV brought
  END
  $fm.s[7]=""
  $fm.hi[1]="" ;our hello
  ; every Com but hello, every Param: fm.recv finds them by place
  $fm.coms="000004 000013 000001 000002 000003 000005 000006 "
  $fm.coms=$fm.coms+"000010 000011 000012 000008 000007 000014 000015 "
  $fm.pars="000000 000001 000002 000003 000004 000005 "
.END
.PROGRAM fm.halt() ;a hold came: forget what was under way; old ring entries show by their tag
  fm.ack=fm.hseq+fm.wseq
  fm.mode=0
  fm.wu=fm.wn
  $fm.oat=""
.END
.PROGRAM fm.tick() ;twice a second: restart a PC program that an error has ended
  TIMER 6=0
  IF TASK(1003)<>1 THEN
    BRAKE
    fm.mode=0
    fm.fault=12
    PCEXECUTE 3: fm.watch
  END
  IF TASK(1002)<>1 THEN
    BRAKE
    fm.mode=0
    fm.fault=12
    PCEXECUTE 2: fm.recv
  END
  IF TASK(1001)<>1 THEN
    fm.fault=12
    PCEXECUTE 1: fm.send
  END
  IF fm.eres<>fm.eresu THEN ;why they had ended
    fm.eresu=fm.eres
    fm.fault=19
  END
.END
.PROGRAM fm.frames() ;fm.null=1 when TOOL and BASE are null
  POINT .a=TOOL
  DECOMPOSE .x[1]=.a
  .s=ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  POINT .a=BASE
  DECOMPOSE .x[1]=.a
  .s=.s+ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  fm.null=ABS(.s<0.001)
.END
.PROGRAM fm.leave() ;end the PC programs and the connection, put back what was changed
  BREAK
  CALL fm.end.pc
  IF fm.sock>0 THEN
    TCP_CLOSE .r,fm.sock
    fm.sock=0
  END
  TCP_END_LISTEN .r,fm.port
  CALL fm.back
.END
.PROGRAM fm.restore() ;after an abort, if fm.main is not started again: EXECUTE fm.restore
  IF EXISTREAL("fm.saved")==0 GOTO none
  IF fm.saved==0 GOTO none
  CALL fm.leave
none:
  RETURN
.END
.PROGRAM fm.back() ;what fm.main changed; the speeds cannot be read, so they get AS's defaults
  TOOL fm.tool0
  BASE fm.base0
  IF fm.cp0==0 THEN
    CP OFF
  END
  IF fm.abs0<>0 THEN
    ABS.SPEED ON
  END
  IF fm.qtool0<>0 THEN
    QTOOL ON
  END
  SPEED 100 ALWAYS
  ACCURACY 1 ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  fm.saved=0
.END
.PROGRAM fm.take() ;one command from the ring
  .$q=$fm.ring[fm.rt]
  .e=fm.ringe[fm.rt]
  .n=fm.rings[fm.rt]
  fm.rt=(fm.rt+1) MOD 64
  IF (.e<>fm.ack) OR (fm.lat<>fm.lack) GOTO odd
fresh:
  .id=VAL($LEFT(.$q,6))
  .cmd=VAL($MID(.$q,9,5))
  IF .cmd==7 GOTO begin7
  .v[1]=VAL($MID(.$q,22,6))
  .v[2]=VAL($MID(.$q,29,6))
  .v[3]=VAL($MID(.$q,36,6))
  .v[4]=VAL($MID(.$q,43,6))
  .v[5]=VAL($MID(.$q,50,6))
  .v[6]=VAL($MID(.$q,57,6))
  fm.mode=fm.mode*ABS(fm.hseq+fm.wseq+fm.stopn==fm.ffe) ;stopped meanwhile
  IF (.cmd>3) AND (.cmd<>13) GOTO obey
  IF fm.mode<>0 GOTO refuse
  IF (fm.set<>127) OR (fm.setc<>fm.conn) GOTO not.set
obey:
  CASE .cmd OF
  VALUE 1,13: ;move to a pose, straight; 13: one of a stream
    POINT fm.p=TRANS(.v[1]/fm.sp,.v[2]/fm.sp,.v[3]/fm.sp,.v[4]/fm.so,.v[5]/fm.so,.v[6]/fm.so)
    .bad=ABS(INRANGE(fm.p)<>0)
    IF fm.rel<>.e THEN ;the first motion after a hold
      CALL fm.release(.e,.bad)
    END
    IF (.cmd==13) AND (fm.stream<>.e) THEN ;a stream begins where the arm is
      CALL fm.fresh
      HERE fm.p0
      POINT fm.s0=fm.p0
      $fm.oat=""
    END
    .turns=ABS($MID(.$q,43,20)<>$fm.oat)
    CALL fm.judge(.cmd,.turns,.bad)
    fm.refd=.bad
    fm.taken=.id
    IF .bad<>0 GOTO done
    POINT fm.p0=fm.p
    fm.stream=.e-(.e+1)*ABS(.cmd==1)
    WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
    IF .cmd==13 THEN
      CALL fm.ready(.e)
      POINT fm.from=fm.s0
      CALL fm.angle(.a)
      CALL fm.pace(.a,fm.v,.bad)
      IF .bad<>0 GOTO done ;too little: it is added to the next one
    ELSE
      BREAK ;a short one would not blend in time
      SPEED fm.v MM/S
      IF .turns<>0 THEN
        CALL fm.turn
      END
    END
    $fm.oat=$MID(.$q,43,20)
    IF fm.hseq+fm.wseq<>.e GOTO done
    LMOVE fm.p
    IF .cmd==13 THEN
      CALL fm.gone(.e)
    END
  VALUE 2,3: ;move to joint angles, by joint angles
    IF .cmd==3 THEN ;from where the joints are when the motion before has ended
      WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
      BREAK
      HERE #fm.j
      DECOMPOSE .x[1]=#fm.j
    ELSE
      FOR .i=1 TO 6
        .x[.i]=0
      END
    END
    FOR .i=1 TO 6
      .x[.i]=.x[.i]+.v[.i]/fm.sj
    END
    POINT #fm.j=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
    POINT fm.p=#fm.j
    .bad=ABS(INRANGE(#fm.j)<>0)
    IF fm.rel<>.e THEN
      CALL fm.release(.e,.bad)
    END
    CALL fm.judge(.cmd,1,.bad)
    fm.refd=.bad
    fm.taken=.id
    IF .bad<>0 GOTO done
    WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
    $fm.oat=""
    fm.stream=-1
    BREAK ;the way counts from where the arm is
    CALL fm.jpace(.bad)
    fm.refd=.bad
    IF .bad<>0 GOTO done
    IF fm.hseq+fm.wseq<>.e GOTO done
    JMOVE #fm.j
  VALUE 5: ;speeds
    IF (MINVAL(.v[1],.v[2],.v[3])<1) OR (MAXVAL(.v[1],.v[2],.v[3])>10000) GOTO refuse
    .s=.v[4]/fm.sv*.v[3]/10000 ;mechanical times modular; the monitor speed comes on top
    IF (.s<0.1) OR (.s>5000) GOTO refuse
    IF .s>fm.lfast GOTO too.fast
    ACCEL .v[1]/100 ALWAYS
    DECEL .v[2]/100 ALWAYS
    fm.v=.s
    fm.taken=.id
  VALUE 6: ;gains
    IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5],.v[6])<0 GOTO refuse
    IF $MID(.$q,15,6)<>"000000" GOTO integral
    fm.kp[1]=.v[1]/500000
    fm.kp[2]=.v[2]/500000
    fm.kp[3]=.v[3]/500000
    fm.kp[4]=.v[4]/500000
    fm.kp[5]=.v[5]/500000
    fm.kp[6]=.v[6]/500000
    fm.taken=.id
    RETURN
integral:
    fm.ki[1]=.v[1]/5000
    fm.ki[2]=.v[2]/5000
    fm.ki[3]=.v[3]/5000
    fm.ki[4]=.v[4]/5000
    fm.ki[5]=.v[5]/5000
    fm.ki[6]=.v[6]/5000
    fm.taken=.id
  VALUE 10: ;limits, a bank for each Param; before all of them came nothing moves
    IF (fm.set==127) AND (fm.setc==fm.conn) GOTO refuse ;reported once: no packet changes them
    .b=VAL($MID(.$q,20,1))
    CASE .b OF
    VALUE 0: ;of force feedback, and the watchdog's
      IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5])<1 GOTO refuse
      IF (.v[6]<100) OR (.v[6]>2000) GOTO refuse
      IF (.v[3]/fm.sv<0.1) OR (.v[3]/fm.sv>5000) GOTO refuse
      fm.lstep=.v[1]/fm.sp
      fm.lturn=.v[2]/fm.so
      fm.lspeed=.v[3]/fm.sv
      fm.ltravel=.v[4]/fm.sp
      fm.lforce=.v[5]/fm.sf
      fm.wd=.v[6]/1000
      SPEED fm.lspeed MM/S ALWAYS ;commands 1 to 3 and 13 bring their own
    VALUE 1: ;of every motion
      IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5])<1 GOTO refuse
      IF (.v[1]/fm.so>=180) OR (.v[4]/fm.so>=180) GOTO refuse
      IF (.v[5]/fm.sv<0.1) OR (.v[5]/fm.sv>5000) GOTO refuse
      fm.lcos=COS(.v[1]/fm.so/2)
      fm.ltorque=.v[2]/fm.sm
      fm.lset=.v[3]/fm.sp
      fm.scos=COS(.v[4]/fm.so/2)
      fm.lfast=.v[5]/fm.sv
      fm.v=MINVAL(fm.v,fm.lfast)
    VALUE 2: ;lower corner of the box of the TCP
      fm.b[1]=.v[1]/fm.sp
      fm.b[2]=.v[2]/fm.sp
      fm.b[3]=.v[3]/fm.sp
    VALUE 3: ;upper corner
      fm.b[4]=.v[1]/fm.sp
      fm.b[5]=.v[2]/fm.sp
      fm.b[6]=.v[3]/fm.sp
    VALUE 4: ;what this controller can execute as a stream
      IF (.v[1]<1) OR (.v[1]>1000) OR (.v[2]<0) OR (.v[2]>fm.sv*100) GOTO refuse
      fm.tmove=.v[1]/1000
      fm.vmin=MAXVAL(.v[2]/fm.sv,0.1)
    VALUE 5: ;speeds of the joints at 100 %
      IF MINVAL(.v[1],.v[2],.v[3],.v[4],.v[5],.v[6])<1 GOTO refuse
      FOR .i=1 TO 6
        fm.jmax[.i]=.v[.i]/fm.sj
      END
    END
    .b=2^.b
    GOTO came
  VALUE 11: ;Param 0: the TCP. Both: the point that force feedback turns about
    IF $MID(.$q,20,1)=="1" GOTO centre
    IF (fm.set==127) AND (fm.setc==fm.conn) GOTO refuse
    POINT fm.tcp=TRANS(.v[1]/fm.sp,.v[2]/fm.sp,.v[3]/fm.sp)
    .b=64
centre:
    POINT fm.ctr=TRANS(.v[1]/fm.sp,.v[2]/fm.sp,.v[3]/fm.sp)
    POINT .m=-fm.ctr
    POINT fm.q0=fm.r0+.m
    IF fm.mode<>0 THEN ;the arm stays: the same pose, told by where this point is
      POINT .c=fm.p+fm.ctr
      DECOMPOSE .x[1]=.c
      fm.c[1]=.x[1]-fm.d[1]
      fm.c[2]=.x[2]-fm.d[2]
      fm.c[3]=.x[3]-fm.d[3]
    END
    IF $MID(.$q,20,1)=="0" GOTO came
    fm.taken=.id
  END
done:
  RETURN
came: ;a part of what has to come before anything moves
  IF fm.setc<>fm.conn THEN
    fm.set=0
    fm.setc=fm.conn
  END
  fm.set=fm.set BOR .b
  fm.h[1]=(fm.b[4]-fm.b[1])/2
  fm.h[2]=(fm.b[5]-fm.b[2])/2
  fm.h[3]=(fm.b[6]-fm.b[3])/2
  POINT fm.in=TRANS(-fm.b[1]-fm.h[1],-fm.b[2]-fm.h[2],-fm.b[3]-fm.h[3])
  fm.taken=.id
  RETURN
begin7: ;command 7, Param 0 or 1; one that came before a stop is void
  IF .n<>fm.stopn GOTO done
  IF (fm.set<>127) OR (fm.setc<>fm.conn) GOTO not.set
  WAIT (fm.bdone==.e) OR (fm.hseq+fm.wseq<>.e)
  IF fm.hseq+fm.wseq<>.e GOTO done
  IF fm.rel<>.e THEN
    .bad=0
    CALL fm.release(.e,.bad)
    IF .bad<>0 GOTO refuse
  END
  IF (fm.mode==0) OR (.e+.n<>fm.ffe) THEN ;not both: the first of them
    fm.stream=-1
    $fm.oat=""
    CALL fm.seed
    fm.mode=0
    fm.ffe=.e+.n
  END
  fm.first=1
  fm.mode=fm.mode BOR (1+VAL($MID(.$q,20,1)))
  fm.refd=0
  fm.taken=.id
  RETURN
not.set:
  fm.refd=13
  fm.taken=.id
  RETURN
too.fast:
  fm.refd=17
  fm.taken=.id
  RETURN
refuse:
  fm.refd=1
  fm.taken=.id
  RETURN
odd: ;older than a hold, or the hold before it is not obeyed yet
  IF (.e<>fm.hseq+fm.wseq) OR (fm.lat<>fm.lack) GOTO done
  CALL fm.halt
  GOTO fresh
  ; A command counts as taken when it has been tested, and before it moves: so the next set
  ; point of a stream is on its way while LMOVE waits for the one before. fm.taken is written
  ; after fm.refd and fm.rel, and the sender reads it before them.
  ; LMOVE, not JMOVE: the way is a straight line of the flange, it keeps the configuration,
  ; and its speed is mm/s.
.END
.PROGRAM fm.release(.e,.bad) ;the first motion after a hold: HELD ends, if TOOL and BASE are null
  fm.fault=fm.fault*ABS(fm.hseq+fm.wseq<>.e) ;one that came with a newer hold stays
  CALL fm.frames
  IF fm.null==0 THEN
    fm.fault=8
    .bad=1
  END
  HERE fm.a0 ;turns count from here
  fm.rel=.e
.END
.PROGRAM fm.judge(.com,.turns,.bad) ;whether fm.p keeps command 10; .bad: the fault, or 0
  IF .bad<>0 GOTO done
  POINT .c=fm.in+fm.p+fm.tcp
  DECOMPOSE .x[1]=.c
  IF MAXVAL(ABS(.x[1])-fm.h[1],ABS(.x[2])-fm.h[2],ABS(.x[3])-fm.h[3])>0 GOTO outside
inside:
  IF .com<>13 GOTO turn
  IF DISTANCE(fm.p0,fm.p)>fm.lset GOTO too.far
turn:
  IF .turns==0 GOTO done
  POINT .m=-fm.a0
  POINT .d=.m+fm.p
  DECOMPOSE .x[1]=.d
  IF ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2))<fm.lcos GOTO turned
  IF .com<>13 GOTO done
  POINT .m=-fm.p0
  POINT .d=.m+fm.p
  DECOMPOSE .x[1]=.d
  IF ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2))<fm.scos GOTO too.far
done:
  RETURN
outside: ;only back in: on no axis farther out than the TCP is now
  HERE .h
  POINT .c=fm.in+.h+fm.tcp
  DECOMPOSE .y[1]=.c
  .o=0
  FOR .i=1 TO 3
    .o=MAXVAL(.o,MINVAL(-fm.h[.i],.y[.i])-.x[.i],.x[.i]-MAXVAL(fm.h[.i],.y[.i]))
  END
  IF .o<0.05 GOTO inside ;what rounding makes of a pose [mm]
  .bad=14
  RETURN
turned:
  .bad=15
  RETURN
too.far:
  .bad=16
  RETURN
  ; The cosine of half the angle of a rotation O, A, T is cos(A/2) cos((O+T)/2).
.END
.PROGRAM fm.turn() ;where a turn takes longer than the way, MM/S alone would not limit it
  HERE fm.from
  CALL fm.angle(.a)
  IF .a*fm.lever>DISTANCE(fm.from,fm.p) THEN
    SPEED MINVAL(3600,MAXVAL(0.1,.a*fm.lever/fm.v)) S ;what SPEED takes
  END
.END
.PROGRAM fm.angle(.a) ;the turn from fm.from to fm.p [deg]
  POINT .m=-fm.from
  POINT .d=.m+fm.p
  DECOMPOSE .x[1]=.d
  .s=COS(.x[5]/2)*SIN((.x[4]+.x[6])/2)
  .a=2*ATAN2(SQRT(SIN(.x[5]/2)*SIN(.x[5]/2)+.s*.s),ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2)))
.END
.PROGRAM fm.fresh() ;no segment goes before the next one: the arm stands
  BREAK
  fm.tnext=0
  fm.short=0
  fm.turned=0
.END
.PROGRAM fm.ready(.e) ;until the next segment may be given
  WAIT (TIMER(5)>=fm.tnext) OR (fm.hseq+fm.wseq<>.e)
  IF fm.short<>0 THEN
    BREAK
    fm.short=0
  END
.END
.PROGRAM fm.gone(.e) ;until the segment is the present motion; the controller may take more ahead
  WAIT (DISTANCE(DEST,fm.s0)<0.002) OR (fm.hseq+fm.wseq<>.e) OR (TIMER(5)>1)
  TIMER 5=0
.END
.PROGRAM fm.pace(.a,.v,.few) ;SPEED from fm.s0 to fm.p, a turn of .a; .few=1: too little to move
  .m=MAXVAL(MSPEED,1)/100 ;what the pendant leaves of .v; the time of a segment stays
  .s=DISTANCE(fm.s0,fm.p)
  .t=MAXVAL(1.02*fm.tmove,.s/(.v*.m),.a*fm.lever/(.v*.m))
  .few=0
  IF .s>=fm.vmin*.t*.m GOTO way
  IF .a*fm.lever>MAXVAL(.s,0.02) GOTO turn
  .few=ABS((.s<0.003) OR (TIMER(5)<0.3))
  IF .few<>0 GOTO done
  SPEED fm.vmin MM/S
  fm.short=1
  GOTO given
turn: ;no travel that MM/S could time
  .t=MAXVAL(.t,0.1/.m)
  SPEED .t*.m S
  GOTO given
way:
  SPEED .s/(.t*.m) MM/S
given:
  fm.tnext=.t
  fm.turned=0
  POINT fm.s0=fm.p
  TIMER 5=0
done:
  RETURN
  ; A controller that plans a segment in less than about 30 ms stops with E1117. So what is received
  ; meanwhile is left to the next segment, and each gets the speed that makes it last fm.tmove.
  ; One that is too short for the slowest speed waits, or is followed by BREAK: it blends into
  ; nothing.
.END
.PROGRAM fm.jpace(.bad) ;in percent: JMOVE takes MM/S for a share, and seconds may not be kept
  HERE .p
  POINT .w=fm.in+.p+fm.tcp
  DECOMPOSE .y[1]=.w
  .o=MAXVAL(0,ABS(.y[1])-fm.h[1],ABS(.y[2])-fm.h[2],ABS(.y[3])-fm.h[3])
  .out=.o ;0 inside the box, else how far the TCP is outside
  HERE .#a
  DECOMPOSE .a[1]=.#a
  DECOMPOSE .b[1]=#fm.j
  .t=0
  .f=0 ;time that the joints need at 100 %
  FOR .i=1 TO 6
    .b[.i]=.b[.i]-.a[.i]
    .t=MAXVAL(.t,ABS(.b[.i])*fm.lever)
    .f=MAXVAL(.f,ABS(.b[.i])/fm.jmax[.i])
  END
  .s=0
  FOR .i=1 TO 8 ;the way of the flange is bent: the longest of eight stretches counts
    FOR .j=1 TO 6
      .x[.j]=.a[.j]+.i/8*.b[.j]
    END
    POINT .#q=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
    POINT .c=.#q
    .s=MAXVAL(.s,8*DISTANCE(.p,.c))
    POINT .p=.c
    POINT .w=fm.in+.c+fm.tcp
    DECOMPOSE .y[1]=.w
    .o=MAXVAL(.o,ABS(.y[1])-fm.h[1],ABS(.y[2])-fm.h[2],ABS(.y[3])-fm.h[3])
  END
  .bad=14*ABS(.o>.out+0.05) ;on its way it would leave the box, or leave it farther
  IF .bad<>0 GOTO done
  .t=MAXVAL(0.1,.s/fm.v,.t/fm.v)
  SPEED MINVAL(100,MAXVAL(0.01,100*.f/.t)) ;what SPEED takes
done:
  RETURN
.END
.PROGRAM fm.seed() ;force feedback starts from where the arm is
  CALL fm.fresh
  HERE fm.p
  DECOMPOSE .x[1]=fm.p
  POINT fm.r0=TRANS(0,0,0,.x[4],.x[5],.x[6])
  POINT .m=-fm.ctr
  POINT fm.q0=fm.r0+.m
  POINT .c=fm.p+fm.ctr
  DECOMPOSE .x[1]=.c
  FOR .i=1 TO 3
    fm.c[.i]=.x[.i]
    fm.d[.i]=0
  END
  POINT fm.rot=NULL
  POINT fm.s0=fm.p
  fm.wu=fm.wn
  TIMER 10=0
  fm.t0=0
.END
.PROGRAM fm.step() ;force feedback: a new wrench, a new target, again and again
again:
  CALL fm.ready(fm.ack)
copy: ;one whole bank: the reading, and what it is above the set point
  .n=fm.wn
  .b=fm.wb
  .zb=fm.zb
  .fn=SQRT(fm.w[.b,1]*fm.w[.b,1]+fm.w[.b,2]*fm.w[.b,2]+fm.w[.b,3]*fm.w[.b,3])
  .tn=SQRT(fm.w[.b,4]*fm.w[.b,4]+fm.w[.b,5]*fm.w[.b,5]+fm.w[.b,6]*fm.w[.b,6])
  .f[1]=(fm.w[.b,1]-fm.w[.zb,1])/fm.sf
  .f[2]=(fm.w[.b,2]-fm.w[.zb,2])/fm.sf
  .f[3]=(fm.w[.b,3]-fm.w[.zb,3])/fm.sf
  IF fm.mode<2 GOTO copied
  .f[4]=(fm.w[.b,4]-fm.w[.zb,4])/fm.sm
  .f[5]=(fm.w[.b,5]-fm.w[.zb,5])/fm.sm
  .f[6]=(fm.w[.b,6]-fm.w[.zb,6])/fm.sm
copied:
  IF (fm.wn<>.n) OR (fm.zb<>.zb) GOTO copy
  fm.wu=.n
  IF (fm.mode==0) OR (fm.hseq+fm.wseq+fm.stopn<>fm.ffe) GOTO over
  IF (.fn>fm.lforce*fm.sf) OR (.tn>fm.ltorque*fm.sm) GOTO pushed
  IF (fm.first<>0) OR (fm.gap<>fm.gapu) OR (fm.t0>300) GOTO anew
  .t=TIMER(10)
  .dt=MINVAL(.t-fm.t0,fm.wd)
  IF .dt<=0 GOTO done ;a coarse TIMER: wait for the next wrench
  fm.t0=.t
  IF fm.mode==2 GOTO rotate
  .x=fm.kp[1]*(.f[1]-fm.f[1])+fm.ki[1]*.f[1]*.dt
  .y=fm.kp[2]*(.f[2]-fm.f[2])+fm.ki[2]*.f[2]*.dt
  .z=fm.kp[3]*(.f[3]-fm.f[3])+fm.ki[3]*.f[3]*.dt
  fm.f[1]=.f[1]
  fm.f[2]=.f[2]
  fm.f[3]=.f[3]
  .s=MAXVAL(SQRT(.x*.x+.y*.y+.z*.z),0.000001)
  .k=MINVAL(1,fm.lstep/.s,fm.lspeed*.dt/.s) ;shortened to the limits of command 10
  fm.d[1]=fm.d[1]+.k*.x
  fm.d[2]=fm.d[2]+.k*.y
  fm.d[3]=fm.d[3]+.k*.z
  IF SQRT(fm.d[1]*fm.d[1]+fm.d[2]*fm.d[2]+fm.d[3]*fm.d[3])>fm.ltravel GOTO too.far
  IF fm.mode==1 GOTO aim
rotate:
  .x=fm.kp[4]*(.f[4]-fm.f[4])+fm.ki[4]*.f[4]*.dt
  .y=fm.kp[5]*(.f[5]-fm.f[5])+fm.ki[5]*.f[5]*.dt
  .z=fm.kp[6]*(.f[6]-fm.f[6])+fm.ki[6]*.f[6]*.dt
  fm.f[4]=.f[4]
  fm.f[5]=.f[5]
  fm.f[6]=.f[6]
  .a=SQRT(.x*.x+.y*.y+.z*.z)
  IF .a<0.00001 GOTO aim
  .o=ATAN2(.y,.x) ;the axis, as O and A of a z axis along it
  .p=ATAN2(SQRT(.x*.x+.y*.y),.z)
  .a=MINVAL(.a,fm.lturn,fm.lspeed*.dt/fm.lever)
  POINT .u=TRANS(0,0,0,.o,.p,0)
  POINT .m=-.u
  POINT fm.rot=.u+RZ(.a)+.m+fm.rot
  fm.turned=fm.turned+.a
aim:
  POINT fm.p=TRANS(fm.c[1]+fm.d[1],fm.c[2]+fm.d[2],fm.c[3]+fm.d[3])+fm.rot+fm.q0
  IF INRANGE(fm.p)<>0 GOTO no.reach
  POINT .c=fm.in+fm.p+fm.tcp
  DECOMPOSE .e[1]=.c
  IF MAXVAL(ABS(.e[1])-fm.h[1],ABS(.e[2])-fm.h[2],ABS(.e[3])-fm.h[3])>0 GOTO outside
  IF fm.mode==1 GOTO go
  POINT .m=-fm.a0
  POINT .d=.m+fm.p
  DECOMPOSE .e[1]=.d
  IF ABS(COS(.e[5]/2)*COS((.e[4]+.e[6])/2))<fm.lcos GOTO turned
go:
  IF fm.tnext>0 GOTO paced
  IF DISTANCE(fm.s0,fm.p)>fm.lstep+20*fm.turned GOTO leap ;the first one, with 1 m of lever
paced:
  CALL fm.pace(fm.turned,fm.lspeed,.few)
  IF .few<>0 GOTO done
  IF fm.hseq+fm.wseq+fm.stopn<>fm.ffe GOTO over
  LMOVE fm.p
  CALL fm.gone(fm.ack)
done:
  WAIT (fm.wn<>fm.wu) OR (fm.rh<>fm.rt) OR (fm.hseq+fm.wseq<>fm.ack) OR (TIMER(6)>0.5)
  IF (fm.wn==fm.wu) OR (fm.rh<>fm.rt) OR (TIMER(6)>0.5) GOTO back
  fm.loops=(fm.loops+1) MOD 500000
  GOTO again
back: ;fm.main does the rest
  RETURN
anew: ;nothing to compare with: no proportional kick, no time to integrate over
  fm.gapu=fm.gap
  fm.first=0
  FOR .i=1 TO 6
    fm.f[.i]=(fm.w[.b,.i]-fm.w[.zb,.i])/fm.sf
    IF .i>3 THEN
      fm.f[.i]=(fm.w[.b,.i]-fm.w[.zb,.i])/fm.sm
    END
  END
  TIMER 10=0
  fm.t0=0
  RETURN
over:
  fm.mode=0
  fm.wu=fm.wn
  RETURN
leap:
  fm.fault=16
  GOTO give.up
too.far:
  fm.fault=6
  GOTO give.up
pushed:
  fm.fault=7
  GOTO give.up
no.reach:
  fm.fault=9
  GOTO give.up
outside:
  fm.fault=14
  GOTO give.up
turned:
  fm.fault=15
give.up: ;hold by ourselves; the watchdog brakes on until the arm is still
  BRAKE
  fm.mode=0
  fm.ask=fm.ask+1
  fm.wu=fm.wn
  RETURN
  ; The law of the specification, f = reading - set point: displacement = displacement +
  ; P (f - f before) + I f dt. The ceilings are for the reading itself. The
  ; rotation likewise, as a turn about one axis through the TCP, composed and never added.
.END
.PROGRAM fm.send() ;PC program 1, the sender
  .conn=-1
  fm.busy=0
again:
  TWAIT fm.tsend
  fm.sbeat=(fm.sbeat+1) MOD 240
  IF (fm.link==0) OR (fm.hw<0) GOTO idle ;say nothing before the watchdog has looked
  IF fm.conn<>.conn GOTO scales
  HERE .#j
  HERE .p
  DECOMPOSE .j[1]=.#j
  DECOMPOSE .x[1]=.p
  IF (MINVAL(.x[1],.x[2],.x[3])*.k<-99999) OR (MAXVAL(.x[1],.x[2],.x[3])*.k>499999) GOTO misfit
  IF MINVAL(.j[1],.j[2],.j[3],.j[4],.j[5],.j[6])*.i<-99999 GOTO misfit
  $fm.t[1]=$RIGHT($ENCODE(/I7,1E6+fm.taken),6)+" 000101 "
  $fm.t[9]=$RIGHT($ENCODE(/I7,1E6+fm.framed),6)+" 000102 "
  .s=fm.hw+256*ABS(fm.lat<>fm.lack)+512*ABS(fm.refd<>0)+128*ABS(fm.hseq+fm.wseq<>fm.rel)
  .s=.s+32*fm.mode*ABS(fm.hseq+fm.wseq+fm.stopn==fm.ffe)+2048*fm.sbeat
  $fm.t[2]=$RIGHT($ENCODE(/I7,1E6+.s),6)+" "
  $fm.t[10]=$fm.t[2]
  $fm.t[3]=$LEFT("-",ABS(.x[1]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[1])*.k)),6-ABS(.x[1]<0))+" "
  $fm.t[4]=$LEFT("-",ABS(.x[2]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[2])*.k)),6-ABS(.x[2]<0))+" "
  $fm.t[5]=$LEFT("-",ABS(.x[3]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[3])*.k)),6-ABS(.x[3]<0))+" "
  $fm.t[6]=$LEFT("-",ABS(.x[4]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[4])*.o)),6-ABS(.x[4]<0))+" "
  $fm.t[7]=$LEFT("-",ABS(.x[5]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[5])*.o)),6-ABS(.x[5]<0))+" "
  $fm.t[8]=$LEFT("-",ABS(.x[6]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[6])*.o)),6-ABS(.x[6]<0))+" "
  $fm.t[11]=$LEFT("-",ABS(.j[1]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[1])*.i)),6-ABS(.j[1]<0))+" "
  $fm.t[12]=$LEFT("-",ABS(.j[2]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[2])*.i)),6-ABS(.j[2]<0))+" "
  $fm.t[13]=$LEFT("-",ABS(.j[3]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[3])*.i)),6-ABS(.j[3]<0))+" "
  $fm.t[14]=$LEFT("-",ABS(.j[4]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[4])*.i)),6-ABS(.j[4]<0))+" "
  $fm.t[15]=$LEFT("-",ABS(.j[5]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[5])*.i)),6-ABS(.j[5]<0))+" "
  $fm.t[16]=$LEFT("-",ABS(.j[6]<0))+$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.j[6])*.i)),6-ABS(.j[6]<0))+" "
  fm.busy=1
  IF fm.link==0 GOTO idle
  TCP_SEND .r,fm.sock,$fm.t[1],16,1
  IF .r<0 GOTO spoiled
  fm.busy=0
  IF fm.sbeat MOD 8<>0 GOTO again
health: ;now and then
  $fm.t[17]=$RIGHT($ENCODE(/I7,1E6+fm.taken),6)+" 000103 "
  .e=ERROR
  IF .e==0 THEN
    .e=fm.fault
  END
  IF (.e==0) AND (fm.refd>1) THEN
    .e=fm.refd
  END
  $fm.t[18]=$LEFT("-",ABS(.e<0))+$RIGHT($ENCODE(/I7,1E6+ABS(.e)),6-ABS(.e<0))+" "
  .w=MINVAL(499999,ROUND(1000*TIMER(8)))
  $fm.t[19]=$RIGHT($ENCODE(/I7,1E6+fm.loops),6)+" "+$RIGHT($ENCODE(/I7,1E6+.w),6)+" "
  .w=(fm.rh-fm.rt+64) MOD 64
  .m=ROUND(100*MSPEED)
  $fm.t[20]=$RIGHT($ENCODE(/I7,1E6+.w),6)+" "+$RIGHT($ENCODE(/I7,1E6+.m),6)+" "
  $fm.t[21]=$RIGHT($ENCODE(/I7,1E6+fm.hid),6)+" "+$RIGHT($ENCODE(/I7,1E6+fm.any),6)+" "
  fm.busy=1
  IF fm.link==0 GOTO idle
  TCP_SEND .r,fm.sock,$fm.t[17],5,1
  IF .r<0 GOTO spoiled
  fm.busy=0
  IF fm.sgc<>fm.conn GOTO again
  $fm.s[1]=$RIGHT($ENCODE(/I7,1E6+fm.framed),6)+" 000104 000000 "
  FOR .n=1 TO 6
    .b=0
    IF fm.sg[.n]>0 THEN
      .b=BITS(fm.sg[.n],16)
    END
    $fm.s[1+.n]=$RIGHT($ENCODE(/I7,1E6+.b),6)+" "
  END
  fm.busy=1
  IF fm.link==0 GOTO idle
  TCP_SEND .r,fm.sock,$fm.s[1],7,1
  IF .r<0 GOTO spoiled
  fm.busy=0
  GOTO again
idle:
  fm.busy=0
  TWAIT 0.05
  GOTO again
scales: ;a new connection
  .conn=fm.conn
  .k=fm.sp
  .o=fm.so
  .i=fm.sj
  GOTO again
misfit: ;never clipped: no pose at all, and 103 says why
  fm.fault=10
  TWAIT 0.2
  GOTO health
spoiled: ;part of a packet may be out: this connection is over
  fm.drops=fm.conn
  WAIT fm.link==0
  GOTO idle
  ; A field is a sign and five digits, or six digits, and a space; made without the options /K
  ; and /L: 1000000 is added and the leading one cut off. TRUE is -1, so ABS makes it 1.
.END
.PROGRAM fm.recv() ;PC program 2, the receiver: bytes to packets, and what cannot wait
  fm.link=0
  fm.arm=0
  fm.hseq=fm.hseq+1
  IF fm.sock>0 THEN
    TCP_CLOSE .r,fm.sock
    fm.sock=0
  END
  .$d="-01234" ;how a number begins that is no ID
  .$z="000000 000000 000000 000000 000000 000000 "
  TCP_END_LISTEN .r,fm.port
listen:
  TCP_LISTEN .r,fm.port
  IF .r<0 THEN
    fm.fault=11
    TCP_END_LISTEN .r,fm.port
    TWAIT 1
    GOTO listen
  END
accept:
  TCP_ACCEPT .s,fm.port,1,fm.ip[1]
  IF .s==-34024 GOTO accept ;nobody came
  IF .s<=0 THEN
    TCP_END_LISTEN .r,fm.port
    TWAIT 1
    GOTO listen
  END
  fm.sock=.s
  .a=ABS(fm.ip[1]-fm.peer[1])+ABS(fm.ip[2]-fm.peer[2])
  .a=.a+ABS(fm.ip[3]-fm.peer[3])+ABS(fm.ip[4]-fm.peer[4])
  IF (fm.any==0) AND (.a<>0) GOTO stranger
  fm.conn=(fm.conn+1) MOD 1000000
  $fm.next=""
  .idle=0
  .$b=""
  .n=0
receive:
  TCP_RECV .r,fm.sock,$fm.rx[1],.n,1,189
  IF (.r<>0) OR (.n<1) OR (fm.dropw==fm.conn) OR (fm.drops==fm.conn) GOTO nothing
  .i=1
join:
  .$b=.$b+$fm.rx[.i] ;at most 62 characters of before and 189
cut:
  IF LEN(.$b)<63 GOTO more
  .$q=$LEFT(.$b,63)
  .$b=$MID(.$b,64)
  IF $LEFT(.$q,7)<>$fm.next GOTO hello ;IDs are consecutive
  CASE INSTR($fm.coms,$MID(.$q,8,7))+100*INSTR($fm.pars,$MID(.$q,15,7)) OF
  VALUE 101: ;4, the wrench
    .k=1
    .b=1-fm.wb ;the bank that nobody reads
    GOTO vector
  VALUE 164: ;12, nothing to say
    IF $MID(.$q,22)<>.$z GOTO wrong
    GOTO arm
  VALUE 108,115,122,129: ;13, 1, 2, 3
    .k=2
    GOTO vector
  VALUE 136,143,843,150,850,1550,2250,2950,3650,157,857: ;5, 6, 10, 11: they arm nothing
    .k=3
    GOTO vector
  VALUE 178,878: ;7, start
    IF $MID(.$q,22)<>.$z GOTO wrong
    .k=2
    GOTO queue
  VALUE 1578: ;7, stop; the arm stays
    IF $MID(.$q,22)<>.$z GOTO wrong
    fm.stopn=fm.stopn+1
    fm.zb=4
    GOTO arm
  VALUE 185: ;14, the set point of force
    .k=1
    .b=2+ABS(fm.zb==2) ;the bank that nobody reads
    GOTO vector
  VALUE 171: ;8, hold
    IF $MID(.$q,22)<>.$z GOTO wrong
stop:
    fm.hseq=fm.hseq+1 ;voids the ring, force feedback, and the motion in hand
    fm.arm=0
    BRAKE
    fm.zb=4
    fm.hid=(fm.framed+1) MOD 500000
    GOTO framed
  VALUE 192,892: ;15, signals; they arm nothing
    CALL fm.signal(.$q,.a)
    IF .a<>0 GOTO framed
  END
  GOTO wrong
vector: ;six numbers: the spaces and no power of ten, the first characters, the other five
  .a=INSTR(22,.$q," ")+INSTR(29,.$q," ")+INSTR(36,.$q," ")+INSTR(43,.$q," ")
  IF .a+INSTR(50,.$q," ")+INSTR(57,.$q," ")+1000*INSTR(.$q,"E")<>273 GOTO wrong
  .a=MINVAL(INSTR(.$d,$MID(.$q,22,1)),INSTR(.$d,$MID(.$q,29,1)),INSTR(.$d,$MID(.$q,36,1)))
  .c=MINVAL(INSTR(.$d,$MID(.$q,43,1)),INSTR(.$d,$MID(.$q,50,1)),INSTR(.$d,$MID(.$q,57,1)))
  .e=MINVAL(VAL("1"+$MID(.$q,23,5)),VAL("1"+$MID(.$q,30,5)),VAL("1"+$MID(.$q,37,5)))
  .f=MINVAL(VAL("1"+$MID(.$q,44,5)),VAL("1"+$MID(.$q,51,5)),VAL("1"+$MID(.$q,58,5)))
  IF (.a*.c<1) OR (MINVAL(.e,.f)<100000) GOTO wrong
  IF .k>1 GOTO queue
  fm.w[.b,1]=VAL($MID(.$q,22,6))
  fm.w[.b,2]=VAL($MID(.$q,29,6))
  fm.w[.b,3]=VAL($MID(.$q,36,6))
  fm.w[.b,4]=VAL($MID(.$q,43,6))
  fm.w[.b,5]=VAL($MID(.$q,50,6))
  fm.w[.b,6]=VAL($MID(.$q,57,6))
  IF .b>1 GOTO aimed
  fm.wb=.b
  fm.wn=(fm.wn+1) MOD 1000000
arm:
  fm.arm=1
framed:
  fm.framed=500000+(fm.framed+1) MOD 500000
  $fm.next=$RIGHT($ENCODE(/I7,1500000+(fm.framed+1) MOD 500000),6)+" "
  GOTO cut
aimed: ;a set point above the ceiling is a hold
  .a=SQRT(fm.w[.b,1]*fm.w[.b,1]+fm.w[.b,2]*fm.w[.b,2]+fm.w[.b,3]*fm.w[.b,3])
  IF .a>fm.lforce*fm.sf THEN
    fm.hseq=fm.hseq+1 ;before the fault, see fm.release
    fm.fault=7
    GOTO stop
  END
  fm.zb=.b
  fm.zn=(fm.zn+1) MOD 1000000
  GOTO arm
queue: ;for fm.main
  .h=(fm.rh+1) MOD 64
  IF .h==fm.rt GOTO full
  $fm.ring[fm.rh]=.$q
  fm.ringe[fm.rh]=fm.hseq+fm.wseq
  fm.rings[fm.rh]=fm.stopn
  fm.rh=.h
  IF .k==2 GOTO arm
  GOTO framed
more:
  IF .i>=.n GOTO receive
  .i=.i+1
  GOTO join
nothing:
  IF (fm.dropw==fm.conn) OR (fm.drops==fm.conn) GOTO lost
  IF .r<>-34024 GOTO lost ;closed, or broken
  .idle=.idle+1 ;silence: the watchdog judges it, but not before a hello
  IF (.idle<6) OR ($fm.next<>"") GOTO receive
  GOTO lost
hello:
  IF $fm.next<>"" GOTO wrong
  CALL fm.hello(.$q)
  IF $fm.next<>"" GOTO cut
  GOTO lost
stranger: ;from another address than the PC's
  fm.fault=18
  TCP_CLOSE .r,fm.sock
  IF .r<0 THEN
    TCP_CLOSE .r,fm.sock
  END
  fm.sock=0
  GOTO accept
full: ;nobody takes anything any more
  fm.hseq=fm.hseq+1 ;before the fault, see fm.release
  fm.fault=5
  GOTO lost
wrong: ;never guess a new start: the connection ends
  fm.hseq=fm.hseq+1
  fm.fault=4
lost: ;hold, close, and listen for the next
  fm.link=0
  fm.arm=0
  fm.hseq=fm.hseq+1
  BRAKE
  TCP_CLOSE .r,fm.sock
  IF .r<0 THEN ;the second call forces it
    TCP_CLOSE .r,fm.sock
  END
  TIMER 4=0
  WAIT (fm.busy==0) OR (TIMER(4)>3) ;the next socket may get the same number
  fm.sock=0
  GOTO accept
  ; The key of a packet: 1, 8, 15 and so on for 4, 13, 1, 2, 3, 5, 6, 10, 11, 12, 8, 7, 14, 15,
  ; and 100, 800 and so on to 3600 for Param 0 to 5; a match in between is no VALUE.
  ; A number is right when it ends where its space belongs (the
  ; places add up to 273), when a sign or a digit below 5 leads, and when "1" with the other five
  ; is 100000 or more: anything but digits would end the number for VAL before. 5 to 9 begin an
  ; ID and nothing else: a packet that is shifted or cut by whole frames is none, see README.md.
.END
.PROGRAM fm.hello(.$q) ;the first packet of a connection: only hello, and only it clears the latch
  IF INSTR(.$q,"E")>0 GOTO strange
  FOR .i=0 TO 8
    .v[.i]=VAL("1"+$MID(.$q,7*.i+1,6))-1000000
    IF .v[.i]<0 GOTO strange
    IF $MID(.$q,7*.i+7,1)<>" " GOTO strange
  END
  IF (.v[0]<500000) OR (.v[1]<>9) GOTO strange
  IF MAXVAL(.v[2],.v[3],.v[4],.v[5],.v[6],.v[7],.v[8])>499999 GOTO strange
  fm.hseq=fm.hseq+1 ;whatever was under way is over
  fm.zb=4
  fm.arm=0
  BRAKE
  .a=(.v[3]>9) AND (.v[3]<100) AND (.v[4]>99) AND (.v[4]<556) AND (.v[5]>49) AND (.v[5]<278)
  .b=(.v[6]>0) AND (.v[6]<1000) AND (.v[7]>9) AND (.v[7]<10000) AND (.v[8]>0) AND (.v[8]<1001)
  IF .a AND .b THEN ;others stay as they are, and the answer tells
    fm.sp=.v[3]
    fm.so=.v[4]
    fm.sj=.v[5]
    fm.sf=.v[6]
    fm.sm=.v[7]
    fm.sv=.v[8]
  END
  fm.taken=.v[0]
  fm.framed=.v[0]
  fm.hid=.v[0]-500000
  $fm.hi[1]=$LEFT(.$q,7)+"000009 "+$RIGHT($ENCODE(/I7,1003000+fm.num),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sp),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.so),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sj),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sf),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sm),6)+" "
  $fm.hi[1]=$fm.hi[1]+$RIGHT($ENCODE(/I7,1000000+fm.sv),6)+" "
  TCP_SEND .r,fm.sock,$fm.hi[1],1,1
  IF (.r<0) OR (.v[2]<>3000+fm.num) GOTO done ;another version, another arm: ours is reported
  $fm.next=$RIGHT($ENCODE(/I7,1500000+(fm.framed+1) MOD 500000),6)+" "
  fm.lack=fm.lat
  fm.link=1
done:
  RETURN
strange: ;a fault of before a good hello stays until the next motion
  fm.fault=4
  RETURN
.END
.PROGRAM fm.signal(.$q,.ok) ;command 15: an output, or the groups of 104; .ok=0: wrong numbers
  .ok=0
  IF INSTR(.$q,"E")>0 GOTO done
  FOR .i=1 TO 6
    .$v=$MID(.$q,7*.i+15,7)
    IF INSTR("-01234",$LEFT(.$v,1))==0 GOTO done
    IF (VAL("1"+$MID(.$v,2,5))<100000) OR ($RIGHT(.$v,1)<>" ") GOTO done
    .v[.i]=VAL($LEFT(.$v,6))
  END
  IF $MID(.$q,15,6)=="000001" GOTO groups
  IF (ABS(.v[1])<1) OR (ABS(.v[1])>960) GOTO done
  SIGNAL .v[1]
  .ok=1
  RETURN
groups: ;all of them are tested before the sender sees one
  FOR .i=1 TO 6
    .a=.v[.i]
    IF (.a<>0) AND ((.a<1) OR (.a>1945) OR ((.a>945) AND (.a<1001))) GOTO done
  END
  FOR .i=1 TO 6
    fm.sg[.i]=.v[.i]
  END
  fm.sgc=fm.conn
  .ok=1
done:
  RETURN
.END
.PROGRAM fm.watch() ;PC program 3, the watchdog
  fm.wseq=fm.wseq+1 ;nothing of before goes on, and a hello is needed
  fm.lat=fm.lat+1
  fm.dropw=fm.conn
  .framed=fm.framed
  .conn=fm.conn
  .w=fm.wn
  .mode=0
  .ask=fm.ask
  .epoch=-1
  .need=0
  .mov=0
  .was=0
  .s=0
  .g=0
  .iv=0.05
  .lim=1
  .beat=fm.sbeat
  .quiet=0
  HERE .#j
  DECOMPOSE .j[11]=.#j
  TIMER 7=0
  TIMER 8=0
  TIMER 9=0
look:
  TWAIT MAXVAL(0.002,fm.twatch*.was) ;at once after RUN: a motion taken ahead may go on
  IF (fm.framed<>.framed) OR (fm.conn<>.conn) THEN ;a new connection may begin at any ID
    .framed=fm.framed
    .conn=fm.conn
    TIMER 7=0
  END
  .m=fm.mode*ABS(fm.hseq+fm.wseq+fm.stopn==fm.ffe) ;a stop needs no wrench any more
  IF .m<>.mode THEN
    .mode=.m
    TIMER 8=0
    .lim=1 ;the first wrench comes when the PC has read that force feedback runs
  END
  IF fm.wn<>.w THEN
    .w=fm.wn
    .iv=0.8*.iv+0.2*MINVAL(TIMER(8),0.5) ;between two wrenches
    TIMER 8=0
    .g=0
    .lim=fm.wd
  END
  IF (.mode<>0) AND (.g==0) AND (TIMER(8)>3*MAXVAL(.iv,fm.twatch)) THEN
    .g=1 ;the next wrench starts anew: none of the correction that was missed
    fm.gap=(fm.gap+1) MOD 1000000
  END
  .a=ABS(fm.arm AND (TIMER(7)>fm.wd-2*fm.twatch)) ;silence
  .b=ABS((.mode<>0) AND (TIMER(8)>.lim-2*fm.twatch)) ;no new wrench
  .ok=ABS(((TASK(1)==1) OR (TASK(1)==3)) AND SWITCH(RUN) AND SWITCH(POWER))
  .s=(.s+1)*MAXVAL(.a,.b) ;looks in a row
  IF (.s>1) OR (.ok<.was) THEN
    .s=0
    IF fm.lat==fm.lack THEN
      fm.wseq=fm.wseq+1
      fm.lat=fm.lat+1
      BRAKE
      fm.dropw=fm.conn
      fm.fault=3
      IF .b<>0 THEN
        fm.fault=2
      END
      IF .a<>0 THEN
        fm.fault=1
      END
    END
  END
  IF (.ok<>.was) OR (fm.ask<>.ask) OR (fm.hseq+fm.wseq<>.epoch) THEN
    IF (.ok>.was) OR (fm.ask<>.ask) THEN ;RUN on the pendant, or fm.main gave up
      .ask=fm.ask
      fm.wseq=fm.wseq+1
    END
    .was=.ok
    .epoch=fm.hseq+fm.wseq ;a hold: brake until the arm is still and fm.main knows
    .need=2
  END
  IF .need>0 THEN
    BRAKE
  END
  IF TIMER(9)<0.1 GOTO look
  .d=TIMER(9)
  TIMER 9=0
  HERE .#j
  DECOMPOSE .j[1]=.#j
  .x=ABS(.j[1]-.j[11])+ABS(.j[2]-.j[12])+ABS(.j[3]-.j[13])
  .x=.x+ABS(.j[4]-.j[14])+ABS(.j[5]-.j[15])+ABS(.j[6]-.j[16])
  DECOMPOSE .j[11]=.#j
  .mov=ABS(.x>fm.still*.d)
  .e=-34000-ERROR ;19 to 57 are of the connection
  IF SWITCH(ERROR) AND (.e>18) AND (.e<58) AND (fm.hseq+fm.wseq<>fm.rel) THEN ;while held only
    MC ERESET
    fm.eres=(fm.eres+1) MOD 1000000
    IF (TASK(1)<>1) AND (TASK(1)<>3) THEN ;the error has stopped fm.main as well
      MC EXECUTE fm.main
    END
  END
  .h=ABS(SWITCH(POWER))+2*ABS(SWITCH(REPEAT))+4*(1-ABS(SWITCH(TEACH_LOCK)))+16*.mov
  fm.hw=.h+8*ABS(((TASK(1)==1) OR (TASK(1)==3)) AND SWITCH(RUN))+1024*ABS(SWITCH(ERROR))
  .quiet=(.quiet+1)*ABS(fm.sbeat==.beat)
  .beat=fm.sbeat
  IF (.quiet>30) AND fm.link THEN ;the sender hangs: nobody reads what it sends
    fm.dropw=fm.conn
    .quiet=0 ;the next connection has its own time
  END
  IF .need==0 GOTO look
  .need=.need-1
  IF .mov OR (fm.ack<>.epoch) OR (.ok==0) THEN
    .need=2
  END
  IF .need==0 THEN
    fm.bdone=.epoch
  END
  GOTO look
  ; A silence counts at the second look, so that after a freeze of the whole controller the
  ; receiver can read what came meanwhile before it is judged.
.END
