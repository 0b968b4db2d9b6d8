.PROGRAM pl.main() ;robot program, process 3: EXECUTE pl.main. Commands, see README.md
  ; forcemesh, protocol plain: the specification to the letter, and none of the protection of
  ; forcemesh.as, which is the default. NO watchdog, NO limits, NO hold, NO hello:
  ; docs/decisions/030-the-plain-protocol.md. This is not a safety function.
  ; pl.main  process 3, robot program: commands 1 to 7; calls ForceFeedBackPosition and
  ;          ForceFeedBackOrientation (of a name AS reads 15 characters)
  ; pl.send  process 1, PC program 1: sends pose and joints without end
  ; pl.recv  process 2, PC program 2: characters to a buffer, the buffer to packets
  CALL pl.config
  CALL pl.begin
  CALL pl.init
  TOOL NULL
  BASE NULL
  CP ON
  ACCURACY pl.accur ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  SPEED pl.v MM/S ALWAYS
  PCEXECUTE 1: pl.send
  PCEXECUTE 2: pl.recv
turn:
  WAIT (pl.rh<>pl.rt) OR (pl.lost<>pl.seen)
  IF pl.lost<>pl.seen THEN ;the connection has ended: nothing continues
    BRAKE
    pl.seen=pl.lost
    pl.mode=0
    pl.new=0
  END
  WHILE pl.rh<>pl.rt DO
    CALL pl.take
  END
  IF (pl.new<>0) AND (pl.mode<>0) THEN
    CALL pl.step
  END
  pl.new=0
  GOTO turn
.END
.PROGRAM pl.config() ;what may be changed: the numbers of gateway and gateway.plain in the cell file
  pl.port=49152 ;TCP port that is listened on, 8192 to 65535
  pl.w=7 ;characters of a number: 7 with the space after it, 6 without
  pl.sp=1 ;packet units per mm
  pl.so=1 ;per degree of O, A, T
  pl.sj=1 ;per degree of a joint
  pl.sf=1 ;per N
  pl.sm=1 ;per N m
  pl.sv=1 ;per mm/s
  pl.sc=1 ;per percent
  pl.sg=1 ;of proportional gains: per mm/N and per deg/(N m)
  pl.si=1 ;of integral gains: per mm/(N s) and per deg/(N m s)
  pl.tx=0 ;the point that ForceFeedBackOrientation turns about, in the flange frame [mm]
  pl.ty=0
  pl.tz=0
  pl.v=50 ;speed until command 5 comes [mm/s]
  pl.accur=10 ;ACCURACY of every motion [mm]
  pl.tsend=0.008 ;pause of process 1 between two samples [s]
  pl.dtmax=0.1 ;longest time that one reading is integrated over [s]
.END
.PROGRAM pl.begin() ;stop what an earlier run left
  IF EXISTREAL("pl.sock")==0 GOTO clean
  IF TASK(1001)<>0 THEN
    PCABORT 1:
  END
  IF TASK(1002)<>0 THEN
    PCABORT 2:
  END
  TIMER 2=0
  WAIT ((TASK(1001)<>1) AND (TASK(1002)<>1)) OR (TIMER(2)>5)
  IF pl.sock>0 THEN
    TCP_CLOSE .r,pl.sock
  END
  TCP_END_LISTEN .r,pl.port
clean:
  pl.sock=0
.END
.PROGRAM pl.init() ;every global gets its value here
  pl.link=0 ;written by pl.recv. 1: connected, process 1 may send
  pl.lost=0 ;connections that have ended
  pl.framed=0 ;ID of the last packet on this connection
  pl.rh=0 ;ring of packets: next free slot
  pl.busy=0 ;written by pl.send. 1: inside TCP_SEND
  pl.drop=-1 ;the pl.lost of a connection that cannot be sent to
  pl.rt=0 ;the rest is pl.main's. Ring: next slot to read
  pl.seen=0 ;the pl.lost that was obeyed
  pl.taken=0 ;ID of the last command
  pl.tkc=0 ;the pl.lost under which it came
  pl.mode=0 ;force feedback: 1 position + 2 orientation
  pl.new=0 ;1: a reading came
  pl.first=0 ;1: the next reading is the first one
  pl.t0=0 ;TIMER(1) at the last iteration
  POINT pl.tcp=TRANS(pl.tx,pl.ty,pl.tz)
  POINT pl.p=NULL ;target
  POINT #pl.j=#HERE ;target of a joint motion
  FOR .i=1 TO 6
    pl.kp[.i]=0 ;gains of command 6
    pl.ki[.i]=0
    pl.f[.i]=0 ;reading of command 4 [N], [N m]
    pl.fb[.i]=0 ;the one before
  END
  FOR .i=1 TO 3
    pl.sr[.i]=pl.sp ;scales of the twelve numbers that are sent
    pl.sr[.i+3]=pl.so
    pl.sr[.i+6]=pl.sj
    pl.sr[.i+9]=pl.sj
  END
  FOR .i=0 TO 31
    $pl.ring[.i]="" ;packets
    pl.ringc[.i]=-1 ;pl.lost when it came
  END
  $pl.gap=$LEFT(" ",pl.w-6) ;after each number
  $pl.gaps=$LEFT("         ",9*(pl.w-6)) ;of a packet
.END
.PROGRAM pl.take() ;one command. 1 to 3 move at once: they end the motion and force feedback before
  .$q=$pl.ring[pl.rt]
  .c=pl.ringc[pl.rt]
  pl.rt=(pl.rt+1) MOD 32
  IF .c<>pl.lost GOTO done
  FOR .i=0 TO 8
    .v[.i]=VAL($MID(.$q,pl.w*.i+1,6)) ;ID, Com, Param, Vec1 to Vec6
  END
  pl.taken=.v[0]
  pl.tkc=.c
  IF (.v[1]==4) OR (.v[1]==5) OR (.v[1]==6) GOTO obey
  IF (.v[1]==7) AND ((pl.mode<>0) OR (.v[2]==2)) GOTO obey
  pl.mode=0
  BRAKE
obey:
  CASE .v[1] OF
  VALUE 1: ;a) to a pose
    POINT pl.p=TRANS(.v[3]/pl.sp,.v[4]/pl.sp,.v[5]/pl.sp,.v[6]/pl.so,.v[7]/pl.so,.v[8]/pl.so)
    IF pl.lost<>.c GOTO done
    LMOVE pl.p
  VALUE 2: ;b) to joint angles
    FOR .i=1 TO 6
      .x[.i]=.v[.i+2]/pl.sj
    END
    GOTO joints
  VALUE 3: ;c) by joint rotations, from where the joints are
    BREAK
    HERE #pl.j
    DECOMPOSE .x[1]=#pl.j
    FOR .i=1 TO 6
      .x[.i]=.x[.i]+.v[.i+2]/pl.sj
    END
    GOTO joints
  VALUE 4: ;d) reading of the sensor, base axes
    FOR .i=1 TO 3
      pl.f[.i]=.v[.i+2]/pl.sf
      pl.f[.i+3]=.v[.i+5]/pl.sm
    END
    pl.new=1
  VALUE 5: ;e) accelerations, and mechanical times modular speed
    ACCEL .v[3]/pl.sc ALWAYS
    DECEL .v[4]/pl.sc ALWAYS
    SPEED .v[6]/pl.sv*.v[5]/pl.sc/100 MM/S ALWAYS
  VALUE 6: ;f) gains
    FOR .i=1 TO 6
      IF .v[2]==0 THEN
        pl.kp[.i]=.v[.i+2]/pl.sg
      ELSE
        pl.ki[.i]=.v[.i+2]/pl.si
      END
    END
  VALUE 7: ;g) force feedback: 0 ForceFeedBackPosition, 1 ForceFeedBackOrientation, 2 stop
    IF .v[2]==2 THEN
      pl.mode=0
      RETURN
    END
    IF pl.mode==0 THEN
      BREAK
      HERE pl.p
    END
    pl.mode=pl.mode BOR (.v[2]+1)
    pl.first=1
  END
done:
  RETURN
joints:
  POINT #pl.j=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
  IF pl.lost<>.c GOTO done
  JMOVE #pl.j
.END
.PROGRAM pl.step() ;an iteration of force feedback for a new reading
  IF (pl.first<>0) OR (pl.t0>300) THEN ;nothing to compare with, no time to integrate over
    pl.first=0
    FOR .i=1 TO 6
      pl.fb[.i]=pl.f[.i]
    END
    TIMER 1=0
    pl.t0=0
    RETURN
  END
  .t=TIMER(1)
  .dt=MINVAL(.t-pl.t0,pl.dtmax)
  pl.t0=.t
  IF pl.mode<>2 THEN
    CALL forcefeedbackpo(.dt)
  END
  IF pl.mode>1 THEN
    CALL forcefeedbackor(.dt)
  END
  IF pl.lost<>pl.seen GOTO done
  LMOVE pl.p
done:
  RETURN
.END
.PROGRAM forcefeedbackpo(.dt) ;ForceFeedBackPosition: forces to zero by displacing along x, y, z
  FOR .i=1 TO 3
    .d[.i]=pl.kp[.i]*(pl.f[.i]-pl.fb[.i])+pl.ki[.i]*pl.f[.i]*.dt
    pl.fb[.i]=pl.f[.i]
  END
  POINT pl.p=SHIFT(pl.p BY .d[1],.d[2],.d[3])
.END
.PROGRAM forcefeedbackor(.dt) ;ForceFeedBackOrientation: moments to zero, base axes
  FOR .i=4 TO 6
    .d[.i]=pl.kp[.i]*(pl.f[.i]-pl.fb[.i])+pl.ki[.i]*pl.f[.i]*.dt
    pl.fb[.i]=pl.f[.i]
  END
  .s=SQRT(.d[4]*.d[4]+.d[5]*.d[5])
  .a=SQRT(.s*.s+.d[6]*.d[6])
  IF .a<0.00001 GOTO done
  .o=ATAN2(.d[5],.d[4]) ;the axis, as O and A of a z axis along it
  .q=ATAN2(.s,.d[6])
  POINT .u=TRANS(0,0,0,.o,.q,0)
  POINT .m=-.u
  POINT .c=pl.p+pl.tcp
  DECOMPOSE .x[1]=.c
  POINT .b=TRANS(.x[1],.x[2],.x[3])
  POINT .n=-.b
  POINT pl.p=.b+.u+RZ(.a)+.m+.n+pl.p
done:
  RETURN
.END
.PROGRAM pl.send() ;PC program 1, process 1: pose and joints without end
again:
  pl.busy=0
  TWAIT pl.tsend
  IF pl.link==0 GOTO again
  HERE .#j
  HERE .p
  DECOMPOSE .x[1]=.p
  DECOMPOSE .x[7]=.#j
  IF MINVAL(.x[1],.x[2],.x[3])*pl.sp<-99999 GOTO misfit
  IF MINVAL(.x[7],.x[8],.x[9],.x[10],.x[11],.x[12])*pl.sj<-99999 GOTO misfit
  .t=pl.taken*ABS(pl.tkc==pl.lost)
  $pl.t[1]=$RIGHT($ENCODE(/I7,1E6+.t),6)+$pl.gap+"000101"+$pl.gap+"000000"+$pl.gap
  $pl.t[8]=$RIGHT($ENCODE(/I7,1E6+pl.framed),6)+$pl.gap+"000102"+$pl.gap+"000000"+$pl.gap
  FOR .i=1 TO 12 ;a sign and five digits, or six digits: made without the options /K and /L
    .m=ABS(.x[.i]<0)
    .$n=$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[.i])*pl.sr[.i])),6-.m)
    $pl.t[.i+1+ABS(.i>6)]=$LEFT("-",.m)+.$n+$pl.gap
  END
  pl.busy=1
  IF pl.link==0 GOTO again
  TCP_SEND .r,pl.sock,$pl.t[1],14,1
  IF .r<0 THEN ;part of a packet may be out
    pl.drop=pl.lost
    pl.busy=0
    WAIT pl.link==0
  END
  GOTO again
misfit: ;never clipped: no packet at all
  TYPE "plain: a pose or joint does not fit into six characters, lower its scale"
  TWAIT 1
  GOTO again
.END
.PROGRAM pl.recv() ;PC program 2, process 2: characters to a buffer, the buffer to packets
  .w=pl.w
  .g=.w-6
  .$d="-0123456789"
listen:
  TCP_LISTEN .r,pl.port
  IF .r<0 THEN
    TCP_END_LISTEN .r,pl.port
    TWAIT 1
    GOTO listen
  END
accept:
  TCP_ACCEPT .s,pl.port,1
  IF .s==-34024 GOTO accept ;no client
  IF .s<=0 THEN
    TCP_END_LISTEN .r,pl.port
    TWAIT 1
    GOTO listen
  END
  pl.sock=.s
  pl.framed=0
  .$b=""
  pl.link=1
receive:
  .n=0
  TCP_RECV .r,pl.sock,$pl.rx[1],.n,1,189
  IF pl.drop==pl.lost GOTO lost
  IF .r==-34024 GOTO receive ;silence is no fault here
  IF (.r<>0) OR (.n<1) GOTO lost ;closed, or broken
  .i=1
join:
  .$b=.$b+$pl.rx[.i] ;at most 62 characters of before and 189
cut:
  IF LEN(.$b)<9*.w GOTO more
  .$q=$LEFT(.$b,9*.w)
  .$b=$MID(.$b,9*.w+1)
  .a=MINVAL(INSTR(.$d,$MID(.$q,1,1)),INSTR(.$d,$MID(.$q,.w+1,1)),INSTR(.$d,$MID(.$q,2*.w+1,1)))
  .e=MINVAL(INSTR(.$d,$MID(.$q,3*.w+1,1)),INSTR(.$d,$MID(.$q,4*.w+1,1)))
  .f=MINVAL(INSTR(.$d,$MID(.$q,5*.w+1,1)),INSTR(.$d,$MID(.$q,6*.w+1,1)))
  .h=MINVAL(INSTR(.$d,$MID(.$q,7*.w+1,1)),INSTR(.$d,$MID(.$q,8*.w+1,1)))
  IF (MINVAL(.a,.e,.f,.h)<1) OR (INSTR(.$q,"E")>0) GOTO wrong
  .a=MINVAL(VAL("1"+$MID(.$q,2,5)),VAL("1"+$MID(.$q,.w+2,5)),VAL("1"+$MID(.$q,2*.w+2,5)))
  .e=MINVAL(VAL("1"+$MID(.$q,3*.w+2,5)),VAL("1"+$MID(.$q,4*.w+2,5)))
  .f=MINVAL(VAL("1"+$MID(.$q,5*.w+2,5)),VAL("1"+$MID(.$q,6*.w+2,5)))
  .h=MINVAL(VAL("1"+$MID(.$q,7*.w+2,5)),VAL("1"+$MID(.$q,8*.w+2,5)))
  IF MINVAL(.a,.e,.f,.h)<100000 GOTO wrong
  .$g=$MID(.$q,7,.g)+$MID(.$q,.w+7,.g)+$MID(.$q,2*.w+7,.g)+$MID(.$q,3*.w+7,.g)
  .$g=.$g+$MID(.$q,4*.w+7,.g)+$MID(.$q,5*.w+7,.g)+$MID(.$q,6*.w+7,.g)+$MID(.$q,7*.w+7,.g)
  .$g=.$g+$MID(.$q,8*.w+7,.g)
  IF .$g<>$pl.gaps GOTO wrong
  .a=VAL($LEFT(.$q,6)) ;ID, from 1
  .e=VAL($MID(.$q,.w+1,6)) ;Com, 1 to 7
  .f=VAL($MID(.$q,2*.w+1,6)) ;Param: 0; 0 and 1 of command 6; 0, 1 and 2 of command 7
  IF (.a<1) OR (.e<1) OR (.e>7) OR (.f<0) OR (.f>MAXVAL(0,.e-5)) GOTO wrong
  .h=(pl.rh+1) MOD 32
  IF .h==pl.rt GOTO full
  $pl.ring[pl.rh]=.$q
  pl.ringc[pl.rh]=pl.lost
  pl.rh=.h
  pl.framed=.a
  GOTO cut
more:
  IF .i>=.n GOTO receive
  .i=.i+1
  GOTO join
full:
  TYPE "plain: 32 commands wait and pl.main takes none, connection closed"
  GOTO lost
wrong: ;never guess a new start: the connection ends
  TYPE "plain: not a packet of commands 1 to 7, connection closed: ",.$q
lost: ;the arm stops; pl.main brakes once more, for a motion that began meanwhile
  pl.link=0
  pl.lost=pl.lost+1
  FOR .i=1 TO 10 ;the controller may keep the motions behind the one that is braked
    BRAKE
    TWAIT 0.02
  END
  TCP_CLOSE .r,pl.sock
  IF .r<0 THEN ;the second call forces it
    TCP_CLOSE .r,pl.sock
  END
  TIMER 2=0
  WAIT (pl.busy==0) OR (TIMER(2)>3) ;the next socket may get the same number
  pl.sock=0
  GOTO accept
  ; A number is right when a sign or digit leads and "1" with the other five is 100000 or more:
  ; anything but a digit would end the number for VAL before, and an E make a power of ten.
.END
